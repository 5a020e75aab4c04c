"""New panoramas find their place in a tour whose poses stay, to the last digit."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import Omnisyn
from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import rotation_angle
from omnisyn_cli.io import write_image
from omnisyn_cli.poses.addition import add_to_file
from omnisyn_cli.poses.estimation import PictureOptions
from omnisyn_cli.poses.file import PosedPanorama, read_poses, write_poses
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

SIZE = (256, 512)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four panoramas of a street; the pose file has all but the third, in a world of its own."""
    folder = tmp_path_factory.mktemp("street")
    scene = generate_scene("street", 101)
    poses = sample_path(scene, 101, 4)
    for k, pose in enumerate(poses):
        write_image(folder / f"{k}.png", render_panorama(scene, pose, SIZE, threads=2)[0])
    write_poses(folder / "truth.json", {f"{k}.png": PosedPanorama(pose) for k, pose in enumerate(poses)})
    document = json.loads((folder / "truth.json").read_text())
    del document["panoramas"]["2.png"]
    document["panoramas"]["0.png"]["title"] = "Gate"
    document["links"] = [["0.png", "1.png"], ["1.png", "3.png"]]
    (folder / "poses.json").write_text(json.dumps(document))
    return folder


def test_a_panorama_is_added_and_the_others_stay(street: Path, omnisyn: Omnisyn) -> None:
    before = json.loads((street / "poses.json").read_text())
    old = [street / f"{k}.png" for k in (0, 1, 3)]
    words = ("poses", "estimate", *old, "--add", street / "2.png", "--threads", 1, "-o", street / "poses.json")
    assert "allow overwriting" in omnisyn.refused(*words)
    said = omnisyn.made(*words, "--overwrite").err
    assert "2.png: matches " in said
    after = json.loads((street / "poses.json").read_text())
    assert {name: after["panoramas"][name] for name in before["panoramas"]} == before["panoramas"]
    assert after["links"][:2] == before["links"]
    assert {"2.png" in link for link in after["links"][2:]} == {True}
    found, truth = (read_poses(street / name).panoramas["2.png"].pose for name in ("poses.json", "truth.json"))
    assert np.degrees(rotation_angle(found.rotation.T @ truth.rotation)) < 0.5
    assert np.linalg.norm(found.position - truth.position) < 0.1
    poses = read_poses(street / "poses.json")
    with pytest.raises(PoseError, match="one that has a pose"):
        add_to_file(old, [street / "2.png"], poses, poses.path, PictureOptions())


def test_what_cannot_be_added_is_refused(street: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_image(tmp_path / "new.png", np.zeros((32, 64, 3), np.uint8))
    words = ("poses", "estimate", street / "0.png", street / "1.png", "-o", street / "more.json")
    assert "in the folder of" in omnisyn.refused(*words, "--add", tmp_path / "new.png")
    assert "expected one of --baseline, --camera-height and --add" in omnisyn.misused(
        *words, "--add", street / "2.png", "--baseline", 1
    )
