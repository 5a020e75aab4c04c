"""What is written for another program comes back as it was: 1e-9 relative, in names, order and poses."""

import json
from pathlib import Path

import numpy as np
import pytest
from foreign_samples import axis_angle, imported, samples, write_images

from omnisyn_cli.errors import OutputPathError, PoseError, WriteError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.export.datasets import FACES
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, read_poses, write_poses
from omnisyn_cli.poses.formats.colmap import colmap_rig_files
from omnisyn_cli.poses.formats.files import ImportedPoses
from omnisyn_cli.poses.formats.writers import EXPORT_FORMATS, export_poses, write_imported

OUTPUTS = {"colmap": "model", "nerfstudio": "transforms.json", "tum": "trajectory.tum"}

every_format = pytest.mark.parametrize("format_name", [name for name in EXPORT_FORMATS if name != "gpano"])
"""Those that hold positions; tags in copies of photographs hold rotations and have tests of their own."""


def turns() -> list[np.ndarray]:
    """Rotations, those that singularities love among them: none, tiny, half turns about every axis, any."""
    special = [(1e-12, 0, 0), (0, 1e-7, 0), (np.pi, 0, 0), (0, np.pi, 0), (0, 0, np.pi), (np.pi - 1e-9, 1e-9, 0)]
    return [
        np.eye(3),
        *(axis_angle(vector)[0] for vector in special),
        *(axis_angle(turn)[0] for turn, _, _ in samples(8)),
    ]


def written(folder: Path) -> PoseFile:
    """A pose file with panoramas beside it, in no order that sorting would give."""
    poses = [Pose(turn, np.array([1e5, -3.0, 1e-4]) * index) for index, turn in enumerate(turns())]
    names = [f"pano {(7 * index) % len(poses)} ü.png" for index in range(len(poses))]
    write_images(folder, names[:-1])
    write_images(folder, names[-1:], size=(32, 64))
    write_poses(folder / "poses.json", {name: PosedPanorama(pose) for name, pose in zip(names, poses, strict=True)})
    return read_poses(folder / "poses.json")


def back(folder: Path, format_name: str) -> ImportedPoses:
    return imported(folder / OUTPUTS[format_name], expected=format_name)


@every_format
def test_round_trip(tmp_path, format_name):
    poses = written(tmp_path)
    export_poses(poses, tmp_path / OUTPUTS[format_name], format_name)
    result = back(tmp_path, format_name)
    assert [view.name for view in result.views] == list(poses.panoramas)
    assert [view.image for view in result.views] == [tmp_path / name for name in poses.panoramas]
    write_imported(tmp_path / "again.json", result)
    again = read_poses(tmp_path / "again.json")
    assert list(again.panoramas) == list(poses.panoramas)
    for name, panorama in poses.panoramas.items():
        pose = again.of(name).pose
        np.testing.assert_allclose(pose.rotation, panorama.pose.rotation, atol=1e-9)
        scale = max(1.0, float(np.linalg.norm(panorama.pose.position)))
        np.testing.assert_allclose(pose.position / scale, panorama.pose.position / scale, atol=1e-9)


def test_rigs_of_faces_come_back_as_panoramas(tmp_path):
    poses = {f"{k}.png": Pose(turn, np.array([1.0, -3.0, 0.5]) * k) for k, turn in enumerate(turns())}
    for name, text in colmap_rig_files(poses, FACES, 64).items():
        (tmp_path / name).write_text(text)
    result = imported(tmp_path, expected="colmap")
    assert [view.name for view in result.views] == list(poses)
    assert all(view.pose.almost_equals(poses[view.name], radians=1e-7) for view in result.views)


def test_colmap_knows_the_sizes(tmp_path):
    export_poses(written(tmp_path), tmp_path / "model", "colmap")
    lines = (tmp_path / "model" / "cameras.txt").read_text(encoding="utf-8").splitlines()
    assert lines[1:] == ["1 EQUIRECTANGULAR 32 16 32 16", "2 EQUIRECTANGULAR 64 32 64 32"]
    assert (tmp_path / "model" / "points3D.txt").is_file()


def test_nerfstudio_paths_are_relative_to_the_file(tmp_path):
    poses = written(tmp_path)
    (tmp_path / "sub").mkdir()
    export_poses(poses, tmp_path / "sub" / "transforms.json", "nerfstudio")
    frames = json.loads((tmp_path / "sub" / "transforms.json").read_text(encoding="utf-8"))["frames"]
    assert [frame["file_path"] for frame in frames] == [f"../{name}" for name in poses.panoramas]
    assert (frames[0]["w"], frames[0]["h"], frames[0]["fl_x"], frames[0]["fl_y"]) == (32, 16, 16, 16)
    result = imported(tmp_path / "sub", expected="nerfstudio", allow_outside=True)
    assert result.views[0].image is not None
    with pytest.raises(PoseError, match=r"inside the source's folder, got '\.\./pano 0 ü\.png'; .* --allow-outside"):
        imported(tmp_path / "sub", expected="nerfstudio")


@every_format
def test_nothing_is_overwritten_unasked(tmp_path, format_name):
    poses, output = written(tmp_path), tmp_path / OUTPUTS[format_name]
    export_poses(poses, output, format_name)
    files = [output] if output.is_file() else sorted(output.iterdir())
    before = [file.read_bytes() for file in files]
    with pytest.raises(OutputPathError, match="--overwrite"):
        export_poses(poses, output, format_name)
    export_poses(poses, output, format_name, overwrite=True)
    assert [file.read_bytes() for file in files] == before
    assert not list(tmp_path.glob(".omnisyn-*"))


@pytest.mark.parametrize("format_name", ["colmap", "nerfstudio"])
def test_sizes_are_read_or_given(tmp_path, format_name):
    write_poses(tmp_path / "poses.json", {"a.png": PosedPanorama(Pose.identity())})
    poses, output = read_poses(tmp_path / "poses.json"), tmp_path / OUTPUTS[format_name]
    with pytest.raises(PoseError, match=r"expected the panorama 'a\.png' .* for its size"):
        export_poses(poses, output, format_name)
    assert not output.exists()
    export_poses(poses, output, format_name, size=(512, 1024))
    assert "1024" in ((output / "cameras.txt") if output.is_dir() else output).read_text(encoding="utf-8")


@every_format
def test_a_full_disk_is_said_of_the_output(tmp_path, monkeypatch, format_name):
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    poses, output = written(tmp_path), tmp_path / OUTPUTS[format_name]
    for way in ("open", "write_text"):
        monkeypatch.setattr(Path, way, full)
    with pytest.raises(WriteError, match=f"{output.name}: expected to write it, got 'No space"):
        export_poses(poses, output, format_name, size=(4, 8))
    assert not output.exists()
