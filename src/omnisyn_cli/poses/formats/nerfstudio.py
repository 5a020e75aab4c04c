"""nerfstudio's ``transforms.json``: camera-to-world matrices in OpenGL axes, which are ours, in a world with z up.

An ``EQUIRECTANGULAR`` camera with ``fl_x = fl_y = h = w / 2`` sees at normalised image coordinates ``(x, y)``, x from
−1 to 1 and y from −½ (bottom) to ½, the direction ``(sin πx · sin φ, cos φ, −cos πx · sin φ)``, ``φ = π (½ − y)``.
``applied_transform`` says how the file's world was made from that of its own source; poses are taken as the file has
them, but for a scale in it (or in ``applied_scale``), which is undone.

Source: nerfstudio documentation, "Data conventions"; ``nerfstudio/cameras/cameras.py``.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io.documents import ForeignModel, listed, read_json, validated
from omnisyn_cli.poses.entries import checked_rotation
from omnisyn_cli.poses.formats.files import find_view
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportOptions, foreign_from_pose, noted

Row = Annotated[list[float], Field(min_length=4, max_length=4)]

Matrix = Annotated[list[Row], Field(min_length=3, max_length=4)]

EQUIRECTANGULAR = "EQUIRECTANGULAR"


class Frame(ForeignModel):
    """One image."""

    file_path: Annotated[str, Field(min_length=1)]
    transform_matrix: Matrix
    camera_model: str | None = None


class Transforms(ForeignModel):
    """The file."""

    frames: Annotated[list[Frame], Field(min_length=1)]
    camera_model: str | None = None
    applied_transform: Matrix | None = None
    applied_scale: Annotated[float, Field(gt=0)] = 1.0


def read_nerfstudio(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the panoramas of a ``transforms.json``, or of its folder."""
    path = source / "transforms.json" if source.is_dir() else source
    document = validated(path, Transforms, read_json(path))
    scale = document.applied_scale * _scale_of(path, document.applied_transform)
    views, skipped, undeclared = [], [], False
    for index, frame in enumerate(document.frames):
        model = frame.camera_model or document.camera_model
        undeclared |= model is None
        if model is not None and model.upper() != EQUIRECTANGULAR:
            skipped.append(frame.file_path)
            continue
        where = f"{path}: frames[{index}]"
        matrix = np.array(frame.transform_matrix)
        if len(matrix) == 4 and np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
            raise PoseError(f"{where}: expected a last row [0, 0, 0, 1], got {matrix[3].tolist()}; transpose it")
        rotation = checked_rotation(f"{where}.transform_matrix", matrix[:3, :3])
        with np.errstate(over="ignore"):
            position = matrix[:3, 3] / scale
        if not np.isfinite(position).all():
            raise PoseError(f"{where}: expected a finite position, got {position.tolist()}; check applied_scale")
        pose = options.pose(Pose(rotation, position), camera="opengl", up="z")
        name = frame.file_path.removeprefix("./")
        views.append(find_view(where, name, pose, [path.parent], options))
    if not views:
        raise PoseError(
            f"{path}: expected frames with camera_model EQUIRECTANGULAR, got {len(skipped)} of others; "
            "only panoramas can be used"
        )
    notes = {
        "distances: nerfstudio promises no scale, they are taken as metres": True,
        "world: applied_transform is kept: z of the file's world is up": document.applied_transform is not None,
        f"distances: divided by the applied scale {scale:.6g}, back to those of the file's own source": (
            abs(scale - 1.0) > 1e-9
        ),
        "cameras: no camera_model, images are taken as equirectangular panoramas": undeclared,
        f"left out: {listed(skipped)}, whose camera_model is not EQUIRECTANGULAR": skipped,
    }
    return ImportedPoses(tuple(views), noted(notes))


def nerfstudio_text(
    poses: Mapping[str, Pose], sizes: Mapping[str, tuple[int, int]], images: Mapping[str, Path | None], folder: Path,
    companions: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
    shared: Mapping[str, Any] = MappingProxyType({}),
) -> str:  # fmt: skip
    """The file's text; paths of images are written relative to ``folder``, sizes are ``(height, width)``.

    ``companions`` are further keys of frames (depth, masks), ``shared`` further keys of the file.
    """
    frames = [
        _frame(name, pose, sizes[name], images[name], folder) | dict(companions.get(name, {}))
        for name, pose in poses.items()
    ]
    lines = ",\n".join(f"  {json.dumps(frame, ensure_ascii=False)}" for frame in frames)
    head = json.dumps({"camera_model": EQUIRECTANGULAR, "orientation_override": "none", **shared}, ensure_ascii=False)
    return f'{head[:-1]}, "frames": [\n{lines}\n]}}\n'


def _frame(name: str, pose: Pose, size: tuple[int, int], image: Path | None, folder: Path) -> dict[str, Any]:
    foreign = foreign_from_pose(pose, camera="opengl", up="z")
    matrix = np.vstack([np.column_stack([foreign.rotation, foreign.position]), [0.0, 0.0, 0.0, 1.0]])
    file = name if image is None else Path(os.path.relpath(image, folder)).as_posix()
    height, width = size
    intrinsics = {"w": width, "h": height, "fl_x": width / 2, "fl_y": height, "cx": width / 2, "cy": height / 2}
    return {"file_path": file, **intrinsics, "transform_matrix": matrix.tolist()}


def _scale_of(path: Path, transform: list[Row] | None) -> float:
    """The scale of a similarity: the cube root of its determinant."""
    if transform is None:
        return 1.0
    linear = np.array(transform)[:3, :3]
    determinant = float(np.linalg.det(linear))
    if not determinant > 0:
        raise PoseError(f"{path}: applied_transform: expected a scaled rotation, got determinant {determinant:.3g}")
    scale = float(np.cbrt(determinant))
    checked_rotation(f"{path}: applied_transform", linear / scale)
    return scale
