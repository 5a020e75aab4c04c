"""``tour.json``: titles, captions, links, hotspots, the start view and the floor plan of a tour; see ``docs/tours.md``.

The file lies beside the pose file and names panoramas as that does. All of it is optional. Angles are degrees: ``yaw``
to the right of the centre of the panorama's picture, ``pitch`` upwards. The pose file may have ``links``, ``title`` and
``caption`` too; ``tour.json`` overrides them.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import SAME_POSITION_METRES
from omnisyn_cli.geometry.sphere import angles_to_direction
from omnisyn_cli.io.documents import listed, read_json, validated
from omnisyn_cli.poses.entries import File, FirstVersion, LinkEntry, Model, Text, Vector
from omnisyn_cli.poses.file import PoseFile, file_beside
from omnisyn_cli.poses.tour import FloorPlan, Hotspot, Link, StartView, Tour, TourPanorama, chain_links, links_between

TOUR_NAME = "tour.json"  # What the file is called where a folder stands for its panoramas
MAX_FILE_BYTES = 16 << 20
MAX_HOTSPOTS = 10_000  # Of a whole tour
MAX_LINK_CHARS = 2000
MIN_PIXELS_APART = 1.0  # Of the control points of a floor plan


def _web_address(link: str) -> str:
    """Only what a browser fetches from a web server: other schemes run scripts or read files."""
    scheme, separator, rest = link.partition("://")
    is_plain = link.isprintable() and not set(link) & set(" \"'<>\\`")
    if not separator or scheme.lower() not in ("http", "https") or not rest.strip("/") or not is_plain:
        raise ValueError("an address that begins with https:// or http://")
    if len(link) > MAX_LINK_CHARS:
        raise ValueError(f"an address of at most {MAX_LINK_CHARS} characters")
    return link


Yaw = Annotated[float, Field(ge=-360, le=360)]
Pitch = Annotated[float, Field(ge=-90, le=90)]


class _HotspotEntry(Model):
    text: Annotated[Text, Field(min_length=1)]
    link: Annotated[str, AfterValidator(_web_address)] | None = None
    image: File | None = None
    yaw: Yaw | None = None
    pitch: Pitch | None = None
    point: Vector | None = None


class _PanoramaEntry(Model):
    title: Text | None = None
    caption: Text | None = None
    hotspots: tuple[_HotspotEntry, ...] = Field(default=(), strict=False)


class _StartEntry(Model):
    panorama: str | None = None
    yaw: Yaw | None = None
    pitch: Pitch = 0.0
    fov: Annotated[float, Field(ge=20, le=115)] | None = None


class _ControlPointEntry(Model):
    pixel: Annotated[list[Annotated[float, Field(ge=-1e6, le=1e6)]], Field(min_length=2, max_length=2)]
    panorama: str | None = None
    position: Vector | None = None


class _PlanEntry(Model):
    image: File
    points: Annotated[list[_ControlPointEntry], Field(min_length=2, max_length=2)]


class _TourDocument(Model):
    version: FirstVersion
    title: Text | None = None
    start: _StartEntry = _StartEntry()
    links: list[LinkEntry] | None = None
    panoramas: dict[str, _PanoramaEntry] = Field(default_factory=dict)
    hotspots: tuple[_HotspotEntry, ...] = Field(default=(), strict=False)
    plan: _PlanEntry | None = None


def read_tour(
    path: Path | None, images: Sequence[Path], poses: PoseFile, title: str, *, is_chain: bool = False,
    allow_outside: bool = False,
) -> Tour:  # fmt: skip
    """The tour through panoramas that have an entry in the pose file; ``path`` is ``tour.json``, if there is one.

    Links are those of ``tour.json``, else of the pose file, else they follow from the positions; with ``is_chain`` they
    lead from every image to the next one. Others than the images are left out. The file's own title replaces ``title``.
    PoseError: no JSON, an unknown key, name or panorama, a link to itself, a picture that is missing or, without
    ``allow_outside``, outside.
    """
    document = _TourDocument(version=1) if path is None else validated(
        path, _TourDocument, read_json(path, "a tour file", MAX_FILE_BYTES), allow_outside=allow_outside
    )  # fmt: skip
    source = _Source(path or poses.path, document, poses, allow_outside)
    names = list(dict.fromkeys(poses.name_of(image) for image in images))
    files = {poses.name_of(image): image for image in images}
    links = chain_links(map(poses.name_of, images)) if is_chain else source.links(names)
    panoramas = tuple(source.panorama(name, files[name]) for name in names)
    start = source.start(names[0])
    if start.panorama not in names:
        start = StartView(names[0])
    hotspots, plan = source.hotspots(document.hotspots), source.plan()
    return Tour(document.title or title, panoramas, links, start, hotspots, plan, poses.is_geographic, poses.is_metric)


class _Source:
    """What a tour file says, with its names looked up in the pose file."""

    def __init__(self, path: Path, document: _TourDocument, poses: PoseFile, allow_outside: bool) -> None:
        self._path, self._document, self._poses, self._allow_outside = path, document, poses, allow_outside
        entries = {self._known(name, "panoramas"): entry for name, entry in document.panoramas.items()}
        self._entries: Mapping[str, _PanoramaEntry] = entries
        count = len(document.hotspots) + sum(len(entry.hotspots) for entry in entries.values())
        if count > MAX_HOTSPOTS:
            raise PoseError(f"{path}: expected at most {MAX_HOTSPOTS:,} hotspots, got {count:,}; remove some")

    def panorama(self, name: str, image: Path) -> TourPanorama:
        posed, entry = self._poses.panoramas[name], self._entries.get(name, _PanoramaEntry())
        title = posed.title if entry.title is None else entry.title
        caption = posed.caption if entry.caption is None else entry.caption
        hotspots = self.hotspots(entry.hotspots, name)
        return TourPanorama(name, image, posed.pose, title or image.stem, caption, hotspots)

    def hotspots(self, entries: Iterable[_HotspotEntry], panorama: str | None = None) -> tuple[Hotspot, ...]:
        """The hotspots of a panorama, or those of the whole tour."""
        spots = []
        for k, entry in enumerate(entries):
            where = "hotspots" if panorama is None else f"panoramas.'{panorama}'.hotspots"
            has_direction = entry.yaw is not None or entry.pitch is not None
            if has_direction == (entry.point is not None) or (panorama is None and has_direction):
                wanted = "a point" if panorama is None else "either yaw and pitch, or a point"
                found = "both" if has_direction and entry.point else "a direction" if has_direction else "neither"
                raise PoseError(f"{self._path}: {where}[{k}]: expected {wanted}, got {found}; write one of them")
            image = None if entry.image is None else self._picture(entry.image, f"{where}[{k}].image")
            direction = None
            if has_direction:
                yaw, pitch = math.radians(entry.yaw or 0.0), math.radians(entry.pitch or 0.0)
                direction = np.asarray(angles_to_direction(np.array(yaw), np.array(math.radians(90.0) - pitch)))
            point = None if entry.point is None else np.array(entry.point, float)
            spots.append(Hotspot(entry.text, entry.link, image, direction, point))
        return tuple(spots)

    def links(self, names: Sequence[str]) -> tuple[Link, ...]:
        """The links that are written, else those that follow from the positions."""
        given: Iterable[Sequence[str]] | None = self._poses.links
        if self._document.links is not None:
            given = [[self._known(name, "links") for name in link] for link in self._document.links]
        if given is None:
            return links_between(names, np.stack([self._poses.panoramas[name].pose.position for name in names]))
        place = {name: k for k, name in enumerate(names)}
        pairs = (sorted(link, key=lambda name: place[name]) for link in given if place.keys() >= set(link))
        return tuple(dict.fromkeys((first, second) for first, second in pairs))

    def start(self, first: str) -> StartView:
        """Where the tour begins: at the first panorama unless the file says otherwise."""
        entry = self._document.start
        name = first if entry.panorama is None else self._known(entry.panorama, "start.panorama")
        yaw, fov = (None if angle is None else math.radians(angle) for angle in (entry.yaw, entry.fov))
        return StartView(name, yaw, math.radians(entry.pitch), fov)

    def plan(self) -> FloorPlan | None:
        entry = self._document.plan
        if entry is None:
            return None
        image = self._picture(entry.image, "plan.image")
        pixels = [(point.pixel[0], point.pixel[1]) for point in entry.points]
        positions = [self._position(point, f"plan.points[{k}]") for k, point in enumerate(entry.points)]
        for what, apart, least in (
            ("pixels", math.dist(*pixels), MIN_PIXELS_APART),
            ("positions", math.dist(*positions), SAME_POSITION_METRES),
        ):
            if apart < least:
                raise PoseError(
                    f"{self._path}: plan.points: expected two points with different {what}, got the same; move one"
                )
        return FloorPlan(image, (pixels[0], pixels[1]), (positions[0], positions[1]))

    def _position(self, point: _ControlPointEntry, where: str) -> tuple[float, float]:
        if (point.panorama is None) == (point.position is None):
            found = "both" if point.panorama else "neither"
            raise PoseError(f"{self._path}: {where}: expected a panorama or a position, got {found}; write one of them")
        if point.panorama is not None:
            position = self._poses.panoramas[self._known(point.panorama, where)].pose.position
            return float(position[0]), float(position[2])
        x, _, z = point.position or [0.0, 0.0, 0.0]
        return x, z

    def _known(self, name: str, where: str) -> str:
        if name not in self._poses.panoramas:
            raise PoseError(
                f"{self._path}: {where}: expected the name of a panorama, got '{name:.60}'; {self._poses.path} has "
                f"{listed(self._poses.panoramas)}"
            )
        return name

    def _picture(self, file: str, where: str) -> Path:
        picture = file_beside(self._path, file, where, "tour file", self._allow_outside)
        if not picture.is_file():
            raise PoseError(f"{self._path}: {where}: expected a picture, got no file '{file}'; add it")
        return picture
