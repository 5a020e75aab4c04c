"""Every command of the page "from camera to video" runs on generated files that are as cameras write them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO
import pytest

from cli.cli_samples import Omnisyn
from omnisyn_cli.geometry.pose import quaternion_from_rotation
from omnisyn_cli.io import open_video
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from test_readme import commands

PAGE = Path(__file__).parents[1] / "docs" / "cameras.md"

SIZE = (192, 384)

CHEAP = ["--frames", "3", "--preset", "fast", "--threads", "2"]

COMMANDS = commands(PAGE)


def write(path: Path, samples: np.ndarray, **tags: Any) -> None:
    path.parent.mkdir(exist_ok=True)
    if path.suffix == ".HEIC":
        pytest.importorskip("pillow_heif").register_heif_opener()
        pytest.importorskip("PIL.Image").fromarray(samples).save(path, quality=95)
        return
    spec = OpenImageIO.ImageSpec(samples.shape[1], samples.shape[0], 3, str(samples.dtype))
    for name, value in tags.items():
        spec.attribute(name, *value) if isinstance(value, tuple) else spec.attribute(name, value)
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec)
    assert writer.write_image(np.ascontiguousarray(samples))
    writer.close()


def gps(position: np.ndarray) -> dict[str, Any]:
    """Tags of a place some metres east, up and −north of 48.1° north, 11.5° east."""
    east, up, south = position
    tags: dict[str, Any] = {"GPS:LatitudeRef": "N", "GPS:LongitudeRef": "E", "GPS:Altitude": 520.0 + float(up)}
    degrees = {"Latitude": 48.1 - south / 111_194.0, "Longitude": 11.5 + east / 74_300.0}
    for name, angle in degrees.items():
        minutes, seconds = divmod(angle * 3600, 60)
        tags[f"GPS:{name}"] = "float[3]", (minutes // 60, minutes % 60, seconds)
    return tags


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What every section names, of two places in a street; poses are right wherever a file tells them."""
    folder = tmp_path_factory.mktemp("cameras")
    scene = generate_scene("street", 101)
    poses = sample_path(scene, 101, 2)
    rendered = [np.rint(render_panorama(scene, pose, SIZE, threads=2)[0] * 255).astype(np.uint8) for pose in poses]
    frames = [cv2.resize(picture, (384, 216), interpolation=cv2.INTER_CUBIC) for picture in rendered]
    with open_video(folder / "walk.mp4", size=(216, 384), fps=1, crf=8) as sink:
        for frame in (frames[0], frames[0], frames[1]):
            sink.write(frame)
    model, rows = ["# none"], ["image;lat;lng;altitude;heading;roll"]
    for k, (picture, pose) in enumerate(zip(rendered, poses, strict=True), start=1):
        places, level = gps(pose.position), {f"GPano:Pose{name}Degrees": 0.0 for name in ("Heading", "Pitch", "Roll")}
        for name in (f"R001000{k}.JPG", f"IMG_00{k}.jpg", f"IMG_000{k}.HEIC", f"hall/hall_{k}.tif", f"cars/{k}.jpg"):
            write(folder / name, picture)
        write(folder / f"hall_{k}.tif", picture.astype(np.uint16) * 257)
        write(folder / f"theta/R001000{k}.JPG", picture, Make="RICOH", Model="RICOH THETA V", **places)
        write(folder / f"gopro/GS01000{k}.JPG", picture, Make="GoPro", Model="GoPro Max", **places, **level)
        write(folder / f"left_{k}.png", np.concatenate([picture, picture]))
        forward = pose.rotation @ [0, 0, -1]
        heading = np.degrees(np.arctan2(forward[0], -forward[2])) % 360
        latitude, longitude = 48.1 - pose.position[2] / 111_194.0, 11.5 + pose.position[0] / 74_300.0
        rows.append(
            f"{k}.jpg;{latitude:.9f};{longitude:.9f};520;{heading:.4f};0".replace(".", ",").replace(",jpg", ".jpg")
        )
        axes = np.diag([1.0, -1.0, -1.0])
        turn = axes @ pose.rotation.T @ axes
        numbers = [*quaternion_from_rotation(turn), *(-turn @ axes @ pose.position)]
        model += [f"{k} {' '.join(map(repr, map(float, numbers)))} 1 hall_{k}.tif", ""]
    (folder / "cars").rename(folder / "street")
    (folder / "places.csv").write_text("\n".join(rows) + "\n")
    (folder / "model").mkdir()
    (folder / "model" / "images.txt").write_text("\n".join(model) + "\n")
    (folder / "model" / "cameras.txt").write_text("1 EQUIRECTANGULAR 384 192 384 192\n")
    return folder


def test_the_page_has_a_section_for_every_family() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for family in ("Ricoh Theta", "Insta360", "GoPro MAX", "Telephone", "DSLR", "Street-view car"):
        assert f"\n## {family}" in text


@pytest.mark.parametrize("words", COMMANDS, ids=[" ".join(words) for words in COMMANDS])
def test_a_command_of_the_page_runs(folder: Path, words: list[str], omnisyn: Omnisyn, monkeypatch) -> None:
    """In the order of the page, as later ones use what earlier ones make; small and cheap where that says nothing."""
    monkeypatch.chdir(folder)
    size = ["--size", "64x36" if "flat" in words else "64x32"]
    more = [*CHEAP, *size, "--overwrite"] if words[0] == "interpolate" else ["--overwrite"]
    omnisyn.made(*words, *more)
    assert (folder / words[words.index("-o") + 1]).stat().st_size > 0
