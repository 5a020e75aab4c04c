"""COLMAP models as they lie in a folder, as text or binary: cameras, images, rigs and frames.

Source: COLMAP documentation, "Output Format" and "Rig Support"; ``src/colmap/scene/reconstruction_io_binary.cc``;
``src/colmap/sensor/models.h``; SphereSfM, ``src/base/camera_models.h``.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io.documents import read_text
from omnisyn_cli.poses.entries import checked_quaternion
from omnisyn_cli.poses.formats.files import data_lines, numbers

IMAGES = "images.txt"
BINARY_IMAGES = "images.bin"

# Files of a model; any of them stands for it.
MODEL_FILES = frozenset(
    {f"{name}.{ending}" for name in ("cameras", "images", "rigs", "frames") for ending in ("txt", "bin")}
)
# COLMAP's panoramas and SphereSfM's, which see a direction at the same pixel.
EQUIRECTANGULAR, SPHERE = "EQUIRECTANGULAR", "SPHERE"

HEADER = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"

# Numbers that a binary camera has, by the number of its model in COLMAP 4.
PARAMETER_COUNTS = (3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2)
# The latter is a fisheye in COLMAP, whose releases with that model write rigs; SphereSfM writes none.
EQUIRECTANGULAR_ID, SPHERE_ID = 17, 11

SPHERE_PARAMETER_COUNT = 3
POINT_BYTES = 24  # Of a 2-D point in ``images.bin``: x, y and the number of its 3-D point
MAX_NAME_BYTES = 4096  # Longer names are no file's
MAX_DIGITS = 20  # Of the greatest number of 64 bits
SENSOR_TYPES = {"CAMERA": 0, "IMU": 1}  # Numbers of the words in text


@dataclass(frozen=True)
class Image:
    """A posed image; ``where`` (file and line or number) begins errors about it."""

    where: str
    name: str
    camera: int
    camera_from_world: Pose


@dataclass(frozen=True)
class Frame:
    """A rig at one moment, with the numbers of its images."""

    rig: int
    rig_from_world: Pose
    images: tuple[int, ...]


@dataclass(frozen=True)
class Model:
    """A model, everything by its number."""

    path: Path  # the file with the images
    models: Mapping[int, str]  # names of the models of the cameras; none without a file of cameras
    images: Mapping[int, Image]  # in the order of the file
    # camera-from-rig of each camera that has one; that of the reference is the identity
    rigs: Mapping[int, Mapping[int, Pose]] = field(default_factory=dict)
    frames: Mapping[int, Frame] = field(default_factory=dict)  # none in models of COLMAP before 3.12, like rigs

    def is_panorama(self, image: Image) -> bool:
        """Whether an image is a panorama; all are where no file tells the cameras."""
        return self.models.get(image.camera, EQUIRECTANGULAR) in (EQUIRECTANGULAR, SPHERE)


def read_model(source: Path) -> Model:
    """The model in a folder, or beside one of its files; text where there is both. PoseError: malformed."""
    folder = (folder_of_model(source) or source) if source.is_dir() else source.parent
    if not (folder / IMAGES).is_file() and (folder / BINARY_IMAGES).is_file():
        readers = {"cameras": _camera, "images": _image, "rigs": _rig, "frames": _frame}
        parts = (dict(_records(folder / f"{name}.bin", read)) for name, read in readers.items())
        return Model(folder / BINARY_IMAGES, *parts)
    of_lines = {"cameras": _text_camera, "rigs": _rig, "frames": _frame}
    models, rigs, frames = (dict(_lines(folder / f"{name}.txt", read)) for name, read in of_lines.items())
    return Model(folder / IMAGES, models, dict(_text_images(folder / IMAGES)), rigs, frames)


def folder_of_model(source: Path) -> Path | None:
    """The folder of a model inside ``source``: itself, or the usual ``sparse/0`` and ``sparse``; None without one."""
    files = (source / folder / name for folder in ("", "sparse/0", "sparse") for name in (IMAGES, BINARY_IMAGES))
    return next((file.parent for file in files if file.is_file()), None)


class _Words:
    """The numbers of a line, one after the other."""

    def __init__(self, where: str, line: str) -> None:
        self.where, self.line, self._words = where, line, iter(line.split())

    def take(self, codes: str) -> list[Any]:
        """Numbers by the codes of :mod:`struct`: ``d`` is a float, everything else is whole."""
        words = [next(self._words, "nothing") for _ in codes]
        try:
            return [
                float(word) if code == "d" else SENSOR_TYPES[word] if word in SENSOR_TYPES else int(word)
                for code, word in zip(codes, words, strict=True)
            ]
        except ValueError as error:
            raise PoseError(f"{self.where}: expected another number, got '{error!s:.80}'; correct the line") from error


class _Bytes:
    """The numbers of a little-endian file, likewise."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.where, self._file = str(path), file

    def take(self, codes: str) -> list[Any]:
        """Numbers by the codes of :mod:`struct`."""
        layout = struct.Struct("<" + codes)
        data = self._file.read(layout.size)
        if len(data) < layout.size:
            raise PoseError(f"{self.where}: expected more bytes, got the end of the file; copy it anew")
        return list(layout.unpack(data))

    def name(self) -> str:
        """Text up to a zero."""
        characters = bytearray()
        while (character := self.take("c")[0]) != b"\0":
            characters += character
            if len(characters) > MAX_NAME_BYTES:
                raise PoseError(f"{self.where}: expected the name of an image, got no end of it; copy the file anew")
        return characters.decode("utf-8", "replace")

    def skip(self, count: int) -> None:
        """Pass over so many bytes."""
        try:
            self._file.seek(count, 1)
        except (OSError, ValueError) as error:  # more than any file has
            raise PoseError(f"{self.where}: expected more bytes, got the end of the file; copy it anew") from error


def _pose(source: _Words | _Bytes) -> Pose:
    values = source.take("ddddddd")
    if not all(map(math.isfinite, values)):
        raise PoseError(f"{source.where}: expected finite numbers, got {values}; correct it")
    return Pose(checked_quaternion(source.where, np.array(values[:4])), np.array(values[4:]))


def _rig(source: _Words | _Bytes) -> tuple[int, dict[int, Pose]]:
    number, count = source.take("II")
    cameras = {}
    for index in range(count):
        kind, sensor = source.take("iI")
        has_pose = index > 0 and source.take("B")[0]
        pose = _pose(source) if has_pose else Pose.identity()
        if kind == SENSOR_TYPES["CAMERA"] and (has_pose or index == 0):
            cameras[sensor] = pose
    return number, cameras


def _frame(source: _Words | _Bytes) -> tuple[int, Frame]:
    number, rig = source.take("II")
    pose, (count,) = _pose(source), source.take("I")
    data = [source.take("iIQ") for _ in range(count)]
    return number, Frame(rig, pose, tuple(image for kind, _, image in data if kind == SENSOR_TYPES["CAMERA"]))


def _records(path: Path, read: Any) -> Iterator[tuple[int, Any]]:
    """What a binary file has of a kind; nothing where there is no such file."""
    if not path.is_file():
        return
    with path.open("rb") as file:
        source = _Bytes(path, file)
        for _ in range(source.take("Q")[0]):
            yield read(source)


def _camera(source: _Bytes) -> tuple[int, str]:
    number, model, _, _ = source.take("IiQQ")
    if not 0 <= model < len(PARAMETER_COUNTS):
        raise PoseError(f"{source.where}: expected a camera model that is known, got {model}; write the model as text")
    is_sphere = model == SPHERE_ID and not Path(source.where).with_name("rigs.bin").exists()
    source.take("d" * (SPHERE_PARAMETER_COUNT if is_sphere else PARAMETER_COUNTS[model]))
    return number, SPHERE if is_sphere else EQUIRECTANGULAR if model == EQUIRECTANGULAR_ID else f"model {model}"


def _image(source: _Bytes) -> tuple[int, Image]:
    (number,) = source.take("I")
    pose, (camera,), name = _pose(source), source.take("I"), source.name()
    source.skip(POINT_BYTES * source.take("Q")[0])
    return number, Image(f"{source.where}: image {number}", name, camera, pose)


def _lines(path: Path, read: Any) -> Iterator[tuple[int, Any]]:
    """What a text has of a kind, a line each; nothing where there is no such file."""
    for number, line in data_lines(path) if path.is_file() else ():
        yield read(_Words(f"{path}:{number}", line))


def _text_camera(source: _Words) -> tuple[int, str]:
    fields = source.line.split()
    if len(fields) < 4 or not _is_number(fields[0]):
        raise PoseError(f"{source.where}: expected CAMERA_ID MODEL WIDTH HEIGHT, got '{source.line:.60}'; correct it")
    return int(fields[0]), fields[1].upper()


def _text_images(path: Path) -> Iterator[tuple[int, Image]]:
    """Number and content of every image; its second line, of 2-D points, may be empty and is passed over."""
    lines = enumerate(read_text(path).splitlines(), start=1)
    for number, line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where = f"{path}:{number}"
        fields = line.split(maxsplit=9)
        if len(fields) != 10 or not (_is_number(fields[0]) and _is_number(fields[8])):
            raise PoseError(f"{where}: expected {HEADER}, got {len(fields)} fields; correct the line")
        values = numbers(where, fields[1:8], 7, "QW QX QY QZ TX TY TZ")
        pose = Pose(checked_quaternion(where, values[:4]), values[4:])
        yield int(fields[0]), Image(where, fields[9].strip(), int(fields[8]), pose)
        follower, points = next(lines, (number + 1, ""))
        if len(points.split()) % 3:
            raise PoseError(
                f"{path}:{follower}: expected 2-D points in threes (X Y POINT3D_ID), or an empty line, after each "
                f"image, got {len(points.split())} fields; insert the line"
            )


def _is_number(word: str) -> bool:
    """Whether a word is a number that something may have."""
    return word.isdecimal() and len(word) <= MAX_DIGITS
