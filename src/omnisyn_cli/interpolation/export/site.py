"""A tour as viewers of panoramas want it: level pictures that all look north, marks by yaw and pitch."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, UInt8

from omnisyn_cli.geometry.pose import Pose, at_same_position, rotation_angle
from omnisyn_cli.geometry.remap import MAX_REMAP_COLUMNS, RemapTable
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import angles_to_direction, direction_to_angles, pixel_to_direction
from omnisyn_cli.interpolation.export.datasets import safe_name
from omnisyn_cli.interpolation.loading import quantized_picture
from omnisyn_cli.poses.tour import Hotspot, Tour, TourPanorama
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions, usable_image
from omnisyn_cli.types import View

PICTURES, DEPTH, HOTSPOTS, CLIPS = "panoramas", "depth", "hotspots", "clips"  # folders of a site
# Files of those folders in the text that describes a tour.
NAMED_FILE = re.compile(
    rf'(?<=")(?:{PICTURES}|{DEPTH}|{HOTSPOTS}|{CLIPS})/\d{{4}}[\w-]*\.(?:jpg|depth|mp4)(?=\\?")', re.A
)

# Rows that are made level at once: tables for whole panoramas would take many times their memory. Radians by which a
# panorama may be turned and count as level and looking north: a third of a pixel of 16384.
REMAP_ROWS, LEVEL_TOLERANCE = 256, 1e-4
DEPTH_ROWS, DEPTH_COLS = 128, 256  # steps of the grid of a depth model; its vertices have to be fewer than 65,536
# Where the mark of a panorama is shown that was taken at the very same place: below, so that it hides little.
SAME_PLACE_PITCH = math.radians(-30.0)


@dataclass(frozen=True)
class SiteMark:
    """A place in a panorama that one can click; files are relative to the site."""

    text: str
    yaw: float  # radians to the right of north (−z of the world)
    pitch: float  # radians above the horizon
    position: Float[np.ndarray, " 3"] | None = None  # metres in the world; None where only the direction is known
    target: str | None = None  # identity of the panorama that it leads to
    clip: str | None = None  # video of the way there
    link: str | None = None  # address that it leads to
    image: str | None = None  # picture that it shows


@dataclass(frozen=True)
class SitePanorama:
    """A panorama of a site; it is level, and its centre looks north."""

    identity: str  # unlike all others, of letters, digits, ``_`` and ``-``
    title: str
    caption: str
    picture: str  # file relative to the site
    position: Float[np.ndarray, " 3"]  # metres in the world
    # radians of the first view, if one begins there
    yaw: float
    pitch: float
    links: tuple[SiteMark, ...]
    hotspots: tuple[SiteMark, ...]


@dataclass(frozen=True)
class Site:
    """All that a viewer is told."""

    title: str
    panoramas: tuple[SitePanorama, ...]
    start: str  # identity of the panorama at which it begins
    fov: float | None  # radians that are seen from top to bottom there; None leaves that to the viewer

    @property
    def links(self) -> int:
        """Ways between panoramas; each leads in both directions."""
        return sum(len(panorama.links) for panorama in self.panoramas) // 2


def site_of(tour: Tour, *, has_clips: bool = False) -> Site:
    """The site of a tour, with a video of every way or without."""
    identities = {
        panorama.name: safe_name(index, panorama.image).replace(".", "_")
        for index, panorama in enumerate(tour.panoramas)
    }
    panoramas = tuple(_panorama(tour, panorama, identities, has_clips) for panorama in tour.panoramas)
    return Site(tour.title, panoramas, identities[tour.start.panorama], tour.start.fov)


def _panorama(tour: Tour, panorama: TourPanorama, identities: Mapping[str, str], has_clips: bool) -> SitePanorama:
    identity, pose, images = identities[panorama.name], panorama.pose, hotspot_pictures(tour)
    links = tuple(_link(pose, tour.by_name[name], identities[name]) for name in tour.neighbours[panorama.name])
    if has_clips:
        links = tuple(replace(link, clip=f"{CLIPS}/{identity}--{link.target}.mp4") for link in links)
    hotspots = tuple(_hotspot(pose, hotspot, images) for hotspot in (*panorama.hotspots, *tour.hotspots))
    yaw, pitch = (links[0].yaw, 0.0) if links else yaw_and_pitch(pose.rotation @ [0.0, 0.0, -1.0])
    if tour.start.panorama == panorama.name and tour.start.yaw is not None:
        ahead = angles_to_direction(np.array(tour.start.yaw), np.array(math.radians(90.0) - tour.start.pitch))
        yaw, pitch = yaw_and_pitch(pose.rotation @ ahead)
    picture = f"{PICTURES}/{identity}.jpg"
    return SitePanorama(identity, panorama.title, panorama.caption, picture, pose.position, yaw, pitch, links, hotspots)


def _link(pose: Pose, other: TourPanorama, identity: str) -> SiteMark:
    if at_same_position(pose, other.pose):
        return SiteMark(other.title, 0.0, SAME_PLACE_PITCH, target=identity)
    yaw, pitch = yaw_and_pitch(other.pose.position - pose.position)
    return SiteMark(other.title, yaw, pitch, other.pose.position, identity)


def _hotspot(pose: Pose, hotspot: Hotspot, images: Mapping[Path, str]) -> SiteMark:
    yaw, pitch = yaw_and_pitch(pose.rotation @ hotspot.direction_from(pose))
    image = None if hotspot.image is None else images[hotspot.image]
    return SiteMark(hotspot.text, yaw, pitch, hotspot.point, link=hotspot.link, image=image)


def yaw_and_pitch(direction: Float[np.ndarray, " 3"]) -> tuple[float, float]:
    """Radians to the right of −z, and above the horizon."""
    azimuth, polar_angle = direction_to_angles(np.asarray(direction, float))
    return float(azimuth), math.radians(90.0) - float(polar_angle)


def hotspot_pictures(tour: Tour) -> dict[Path, str]:
    """Where the site has the picture of each hotspot."""
    return {picture: f"{HOTSPOTS}/{index:04d}.jpg" for index, picture in enumerate(tour.hotspot_pictures)}


def photograph(view: View, columns: int) -> UInt8[np.ndarray, "rows cols 3"]:
    """The picture of a panorama in 8 bits, at most so many columns wide.

    What is masked is shown where it has been photographed, and painted over where it has not.
    """
    picture = usable_image(view, SynthesisOptions(view.image.shape[:2]))
    if view.shows_masked:
        picture = view.image if view.image_uint8 is None else view.image_uint8
    return quantized_picture(picture, min(columns, MAX_REMAP_COLUMNS))


def levelled(
    picture: UInt8[np.ndarray, "height width 3"], rotation: Float[np.ndarray, "3 3"]
) -> UInt8[np.ndarray, "height width 3"]:
    """A panorama as if its camera had stood upright and looked north; ``rotation`` is world-from-camera."""
    if rotation_angle(rotation) < LEVEL_TOLERANCE:
        return picture
    size, col = picture.shape[:2], np.arange(picture.shape[1], dtype=float)[None, :]
    level = np.empty_like(picture)
    for begin in range(0, size[0], REMAP_ROWS):
        row = np.arange(begin, min(begin + REMAP_ROWS, size[0]), dtype=float)[:, None]
        directions = pixel_to_direction(row, col, size) @ rotation
        level[begin : begin + REMAP_ROWS] = RemapTable.for_directions(directions, picture.shape).bicubic(picture)
    return level


def depth_model(
    inverse_depth: Float32[np.ndarray, "rows cols"], rotation: Float[np.ndarray, "3 3"], farthest: float
) -> tuple[Float[np.ndarray, "vertices 3"], np.ndarray]:
    """The surface of a levelled panorama as vertices in our axes, metres, and triangles ``(count, 3)``.

    Inverse depth is 1/metre in the frame of the camera, negative where it is not known; ``rotation`` is
    world-from-camera. From ``farthest`` metres on, and where nothing is known, the surface is a sphere.
    """
    azimuth = math.radians(360.0) * (np.arange(DEPTH_COLS) / DEPTH_COLS - 0.5)
    polar_angle = math.radians(180.0) * np.arange(DEPTH_ROWS + 1) / DEPTH_ROWS
    directions = np.asarray(angles_to_direction(azimuth[None, :], polar_angle[:, None]))
    found = np.asarray(sample_nearest(inverse_depth, directions @ rotation))
    vertices = directions / np.maximum(found, 1.0 / farthest)[..., None]
    index = np.arange((DEPTH_ROWS + 1) * DEPTH_COLS).reshape(DEPTH_ROWS + 1, DEPTH_COLS)
    here, right = index[:-1], np.roll(index, -1, axis=1)[:-1]
    below, below_right = index[1:], np.roll(index, -1, axis=1)[1:]
    quads = np.stack([here, below, below_right, here, below_right, right], axis=-1)
    return vertices.reshape(-1, 3), quads.reshape(-1, 3)
