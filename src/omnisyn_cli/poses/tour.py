"""A tour: linked panoramas with names, hotspots, a start view and a floor plan; :mod:`.tour_file` reads its file."""

import heapq
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import normalize

Link = tuple[str, str]
"""Names of two panoramas that one walks between, in either direction."""

# Relative difference below which two distances are equal, so that a square grid has no links across.
NEIGHBOUR_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Hotspot:
    """A mark in the tour; it has either a direction or a point."""

    text: str  # what it says
    link: str | None = None  # an ``http:`` or ``https:`` address that it leads to, or None
    image: Path | None = None  # a picture that it shows, or None
    direction: Float[np.ndarray, " 3"] | None = None  # unit vector in the frame of its panorama, or None
    point: Float[np.ndarray, " 3"] | None = None  # place in the world in metres, or None

    def direction_from(self, pose: Pose) -> Float[np.ndarray, " 3"]:
        """Unit vector towards it in the frame of a panorama: of its own one if it has a direction."""
        if self.direction is not None:
            return self.direction
        return np.asarray(normalize(pose.inverse().transform(np.asarray(self.point))))


@dataclass(frozen=True)
class TourPanorama:
    """A panorama of a tour."""

    name: str  # in the pose file
    image: Path  # its file
    pose: Pose  # camera-to-world, metres
    title: str  # its title; the name of its file without the ending unless the user gave one
    caption: str = ""  # a sentence about it, or empty
    hotspots: tuple[Hotspot, ...] = ()  # marks that belong to it


@dataclass(frozen=True)
class StartView:
    """Where a tour begins."""

    panorama: str  # its name
    yaw: float | None = None  # radians to the right of the centre of its picture; None looks along the first link
    pitch: float = 0.0  # radians above the centre of its picture
    fov: float | None = None  # radians that are seen from top to bottom; None leaves it to the viewer


@dataclass(frozen=True)
class FloorPlan:
    """A picture of the floor from above, with two control points."""

    image: Path  # its file
    pixels: tuple[tuple[float, float], tuple[float, float]]  # (column, row) of both points, from the upper left corner
    positions: tuple[tuple[float, float], tuple[float, float]]  # (x, z) of both points in the world, metres

    def position_of(self, col: float, row: float) -> tuple[float, float]:
        """(x, z) in the world of a place in the picture: the similarity of the control points, without a mirror."""
        (first, second), (here, there) = ([complex(*at) for at in both] for both in (self.pixels, self.positions))
        pixels_per_metre = (second - first) / (there - here)  # scale and turn: rows grow downwards, z southwards
        moved = (complex(col, row) - first) / pixels_per_metre + here
        return moved.real, moved.imag


@dataclass(frozen=True)
class Tour:
    """Panoramas and what connects them."""

    title: str  # of the whole tour
    panoramas: tuple[TourPanorama, ...]  # in the order of the job
    links: tuple[Link, ...]  # pairs of names, each once
    start: StartView  # where it begins
    hotspots: tuple[Hotspot, ...] = ()  # marks with points that every panorama shows
    plan: FloorPlan | None = None  # floor plan, or None
    is_geographic: bool = False  # whether the world's −z is north
    is_metric: bool = True  # whether its unit is known to be the metre

    @cached_property
    def by_name(self) -> Mapping[str, TourPanorama]:
        """The panoramas by their names."""
        return {panorama.name: panorama for panorama in self.panoramas}

    @cached_property
    def hotspot_pictures(self) -> tuple[Path, ...]:
        """The pictures that hotspots show, each once."""
        every = (*self.hotspots, *(spot for panorama in self.panoramas for spot in panorama.hotspots))
        return tuple(dict.fromkeys(hotspot.image for hotspot in every if hotspot.image is not None))

    @cached_property
    def neighbours(self) -> Mapping[str, tuple[str, ...]]:
        """The panoramas that each one links to, in the order of the links."""
        found: dict[str, list[str]] = {panorama.name: [] for panorama in self.panoramas}
        for first, second in self.links:
            found[first].append(second)
            found[second].append(first)
        return {name: tuple(others) for name, others in found.items()}

    def shortest_path(self, first: str, last: str) -> tuple[str, ...]:
        """Names along the shortest way over links, in metres, both ends included; PoseError: no links lead there."""
        queue: list[tuple[float, tuple[str, ...]]] = [(0.0, (first,))]
        done: set[str] = set()
        while queue:
            metres, path = heapq.heappop(queue)
            here = path[-1]
            if here == last:
                return path
            if here in done:
                continue
            done.add(here)
            for name in self.neighbours[here]:
                step = math.dist(self.by_name[here].pose.position, self.by_name[name].pose.position)
                heapq.heappush(queue, (metres + step, (*path, name)))
        raise PoseError(f"expected links that lead from '{first}' to '{last}', got none; add one to \"links\"")

    def path_through(self, names: Sequence[str]) -> tuple[str, ...]:
        """Names along the shortest way through the given ones in their order."""
        parts = [self.shortest_path(*ends) for ends in pairwise(names)]
        return (*names[:1], *(name for part in parts for name in part[1:]))


def chain_links(names: Iterable[str]) -> tuple[Link, ...]:
    """Links from each to the next; none from a panorama to itself, and each link once."""
    found: dict[frozenset[str], Link] = {}
    for pair in pairwise(names):
        if pair[0] != pair[1]:
            found.setdefault(frozenset(pair), pair)
    return tuple(found.values())


def links_between(
    names: Sequence[str], positions: Float[np.ndarray, "n 3"], matched: Iterable[Link] | None = None
) -> tuple[Link, ...]:
    """Links that follow from positions: the relative neighbourhood graph.

    Two panoramas are linked unless a third one is nearer to both than they are to each other. So corridors become
    chains and crossings stay crossings; all stay connected. Where it is known which pairs ``matched``, the way between
    others leads over these. Source: Toussaint, "The relative neighbourhood graph of a finite planar set", 1980.
    """
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    may_link = np.full(distance.shape, matched is None)
    place = {name: k for k, name in enumerate(names)}
    for first, second in matched or ():
        may_link[place[first], place[second]] = may_link[place[second], place[first]] = True
    distance = np.where(may_link, distance, np.inf)
    for middle in range(len(names)):
        distance = np.minimum(distance, distance[:, middle, None] + distance[middle])
    links = []
    for here in range(len(names)):
        via = np.maximum(distance[here][:, None], distance)  # third × other
        via[here] = np.inf
        np.fill_diagonal(via, np.inf)
        is_linked = may_link[here] & (via.min(axis=0) >= distance[here] * (1.0 - NEIGHBOUR_TOLERANCE))
        links += [(names[here], names[other]) for other in range(here + 1, len(names)) if is_linked[other]]
    return tuple(links)
