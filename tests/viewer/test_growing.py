"""A tour grows: files of a walk that nothing new concerns keep their bytes and their date."""

import json
import os
from pathlib import Path

from cli.cli_samples import Omnisyn
from interpolation_samples import CHAIN
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, read_poses, write_poses
from synthesis_samples import posed, write_hall


def test_a_panorama_that_is_added_leaves_the_files_of_others(tmp_path: Path, omnisyn: Omnisyn, monkeypatch) -> None:
    """The last one is linked to the third alone; depth is known."""
    folder = tmp_path / "tour"
    folder.mkdir()
    poses = [*CHAIN, posed((1.0, 0, -0.4), 0.2)]
    images = write_hall(folder, poses)
    whole = read_poses(folder / "poses.json").panoramas
    names = [*whole]
    links = [[names[0], names[1]], [names[1], names[2]]]
    write_poses(folder / "poses.json", {name: whole[name] for name in names[:3]}, links=links)

    def add(images: object, new: object, pose_file: PoseFile, output: Path, options: object) -> tuple[str, ...]:
        entries: dict[str, PosedPanorama] = {**pose_file.panoramas, names[3]: whole[names[3]]}
        write_poses(output, entries, links=[*links, [names[2], names[3]]])
        return ("added",)

    monkeypatch.setattr("omnisyn_cli.poses.addition.add_to_file", add)
    walk = tmp_path / "walk"
    words = ("view", folder, "-o", walk, "--folder", "--threads", 1, "--nadir", 0)
    omnisyn.made(*words)
    former = json.loads((walk / "walk.json").read_text())
    seen_from_outside = former["files"][former["dollhouse"]["inverseDepth"]["block"]]  # one file for the whole tour
    before = {path.name: path.read_bytes() for path in walk.iterdir() if path.name != seen_from_outside}
    for path in walk.iterdir():
        os.utime(path, (1, 1))
    assert "added" in omnisyn.made(*words, "--add", images[3], "--overwrite").err
    manifest = json.loads((walk / "walk.json").read_text())
    assert [panorama["name"] for panorama in manifest["panoramas"]] == names
    for name, content in before.items():
        if name not in ("walk.json", "index.html"):  # which say the title
            assert (walk / name).read_bytes() == content
            assert (walk / name).stat().st_mtime == 1
    assert {path.name for path in walk.iterdir()} > {*before}
