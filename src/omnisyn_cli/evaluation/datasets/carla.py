"""The CARLA data that the authors of OmniSyn published: ``Town*/run/{rgb,depth}/FRAME.png`` with ``gnss_data.json``.

What is assumed (from the authors' ``data_readers/carla_reader.py``, AugmentariumLab/omnisyn):

* ``gnss_data.json`` lists the frames of a run in the order of driving: ``frame`` (the number in the file names),
  ``location`` (x, y, z) and ``rotation`` (pitch, yaw, roll in degrees) of Unreal's left-handed world: x forward,
  y right, z up, yaw clockwise seen from above, pitch up, roll clockwise. ``latitude`` and ``longitude`` (degrees) are
  there as well.
* Here the position is ``(y, z, −x)``. Directions come from the locations, lengths from the geographic positions, as
  the authors take them, where both differ by more than :data:`SAME_LENGTH`: then locations are not in metres. Where
  they agree, the locations are kept, which are exact.
* The image centre looks along the car.
* ``depth`` is a 16-bit PNG in millimetres, in equirectangular pixels, but *along the axis of the cube face* that each
  pixel was rendered on (``use_euclidean_dist`` of the authors' reader): the Euclidean distance is that value over the
  largest component of the pixel's direction. Zero and 65535 mean that nothing is there or it is farther away.

Frames without both pictures are left out, as the authors do. Every run is one scene.
"""

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.evaluation.datasets.sources import SceneFrame, SceneSource
from omnisyn_cli.geometry.pose import Pose, enu_from_geographic, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io import read_inverse_depth
from omnisyn_cli.io.documents import ForeignModel, read_json, validated

POSES = "gnss_data.json"

SAME_LENGTH = 0.05
"""Relative difference of two measures of one length that is put down to the shape of the earth."""

FARTHEST = 65.535
"""Metres; the largest number that the files can hold."""


class _Location(ForeignModel):
    x: float
    y: float
    z: float


class _Rotation(ForeignModel):
    pitch: float
    yaw: float
    roll: float


class _Entry(ForeignModel):
    frame: int
    location: _Location
    rotation: _Rotation
    latitude: float | None = None
    longitude: float | None = None


class _Run(ForeignModel):
    frames: list[_Entry]


def carla_scenes(folder: Path) -> list[SceneSource]:
    """The runs of all towns of a folder, of one town, or a single run; none where nothing has this layout."""
    pattern = next((p for p in (POSES, f"*/{POSES}", f"*/*/{POSES}") if any(folder.glob(p))), POSES)
    runs = sorted(path.parent for path in folder.glob(pattern))
    names = [run.relative_to(folder).as_posix() if run != folder else folder.resolve().name for run in runs]
    return [SceneSource(name, partial(_frames, run)) for name, run in zip(names, runs, strict=True)]


def _frames(run: Path) -> Iterator[SceneFrame]:
    listed = validated(run / POSES, _Run, {"frames": read_json(run / POSES)}).frames
    entries = [entry for entry in listed if all(path.is_file() for path in _files(run, entry))]
    locations = [[entry.location.y, entry.location.z, -entry.location.x] for entry in entries]
    positions = _scaled(np.array(locations).reshape(-1, 3), entries)
    for entry, position in zip(entries, positions, strict=True):
        turn = entry.rotation
        rotation = rotation_from_heading(*map(math.radians, (turn.yaw, turn.pitch, turn.roll)))
        image, depth = _files(run, entry)
        yield SceneFrame(image.name, image, Pose(rotation, position), depth, None, read_face_depth)


def _files(run: Path, entry: _Entry) -> tuple[Path, Path]:
    return run / "rgb" / f"{entry.frame}.png", run / "depth" / f"{entry.frame}.png"


def _scaled(positions: np.ndarray, entries: list[_Entry]) -> Float[np.ndarray, "frames 3"]:
    """Locations in metres; see the module's docstring."""
    places = [(e.latitude, e.longitude) for e in entries if e.latitude is not None and e.longitude is not None]
    if not entries or len(places) != len(entries):
        return positions
    origin = (*places[0], 0.0)
    there = np.array([enu_from_geographic(*place, 0.0, origin) for place in places])
    offsets = positions - positions[0]
    farthest = int(np.argmax(np.linalg.norm(offsets, axis=1)))
    length, geographic = np.linalg.norm(offsets[farthest]), np.linalg.norm(there[farthest])
    if length == 0 or geographic == 0 or abs(geographic / length - 1) < SAME_LENGTH:
        return positions
    return np.asarray(positions[0] + offsets * (geographic / length))


def read_face_depth(path: Path) -> Float[np.ndarray, "height width"]:
    """Inverse Euclidean distance of depth along the axes of cube faces, see the module's docstring."""
    inverse = read_inverse_depth(path)
    along_axis = np.abs(pixel_directions(*inverse.shape)).max(axis=-1)
    is_known = inverse > 1.0 / (FARTHEST - 5e-4)
    return np.where(is_known, inverse * along_axis, 0.0).astype(np.float32)
