"""The documentation: its commands parse and run, its examples exist, and what ``import omnisyn_cli`` offers."""

import pydoc
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import wave
from dataclasses import fields
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
import OpenImageIO
import pytest

import omnisyn_cli as omnisyn
from cli.cli_samples import Omnisyn
from omnisyn_cli.cli import cli
from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.evaluation import public_api as verbs_that_compare
from omnisyn_cli.geometry.pose import quaternion_from_rotation
from omnisyn_cli.interpolation import api
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.viewer.page import module_code
from omnisyn_cli.io import open_video, read_header, read_panorama
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from synthesis_samples import SIZE, hall_image, hall_view, posed, write_hall, ws_psnr

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
DOCUMENTS = [ROOT / "CONTRIBUTING.md", README, *sorted(ROOT.glob("[a-z]*/*.md"))]
WITHOUT_MORE = {"--help", "--list-methods"}  # Options that print something and end the command.


def commands(document: Path) -> list[list[str]]:
    """Every ``omnisyn`` command in the code blocks of a document, as words."""
    blocks = re.findall(r"^```(?:sh|console|bash)?\n(.*?)^```", document.read_text(encoding="utf-8"), re.M | re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    parts = [part.strip() for line in lines for part in line.split("&&")]
    return [shlex.split(part, comments=True)[1:] for part in parts if part.startswith("omnisyn ")]


CASES = [(document, words) for document in DOCUMENTS for words in commands(document)]


@pytest.mark.parametrize(("document", "words"), CASES, ids=[" ".join(words) for _, words in CASES])
def test_every_command_parses(document: Path, words: list[str]) -> None:
    command: click.Command = cli
    with click.Context(cli, info_name="omnisyn", **cli.context_settings) as context:
        while isinstance(command, click.Group):
            found = command.get_command(context, words[0])
            assert found is not None, f"{document.name}: there is no command {words[0]}"
            command, words = found, words[1:]
        if not WITHOUT_MORE & set(words):
            command.make_context(command.name, list(words), parent=context)


@pytest.mark.parametrize(("document", "words"), CASES, ids=[" ".join(words) for _, words in CASES])
def test_every_example_that_is_named_exists(document: Path, words: list[str]) -> None:
    for word in words:
        if word.startswith("examples/"):
            assert (ROOT / word).exists(), f"{document.name} names {word}"


def test_the_set_up_is_the_two_lines_that_were_promised() -> None:
    text = README.read_text(encoding="utf-8")
    assert (
        "python -m pip install . && omnisyn interpolate examples/street/first.jpg examples/street/second.jpg "
        "--poses examples/street/poses.json -o street.mp4\n```\n```\n"
        'python -m pip install ".[test]" && python -m pytest\n'
    ) in text


def test_the_readme_opens_with_a_picture_that_exists() -> None:
    picture = re.search(r"!\[[^\]]+\]\(([^)]+)\)", README.read_text(encoding="utf-8")[:1500])
    assert picture is not None
    assert (ROOT / picture.group(1)).is_file()


def test_links_to_files_lead_somewhere() -> None:
    for document in DOCUMENTS:
        for link in re.findall(r"\]\((?!https?://|#|mailto:)([^)#]+)", document.read_text(encoding="utf-8")):
            assert (document.parent / link).exists(), f"{document.name} links to {link}"


def test_the_first_command_can_be_planned(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    words = next(words for document, words in CASES if document == README and "examples/street/first.jpg" in words)
    monkeypatch.chdir(ROOT)
    arguments = [*words[: words.index("-o")], "-o", str(tmp_path / "street.mp4"), "--dry-run", "--json"]
    assert cli.main(arguments, standalone_mode=False) is None
    assert not list(tmp_path.iterdir())


EXAMPLES = Path(__file__).parents[1] / "examples"
FOLDERS = sorted(path for path in EXAMPLES.iterdir() if path.is_dir())


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_every_pair_is_complete(folder: Path) -> None:
    poses = read_poses(folder / "poses.json")
    for name in ("first.jpg", "second.jpg"):
        panorama = read_panorama(folder / name)
        assert panorama.image.shape[1] == 2 * panorama.image.shape[0]
        assert poses.of(folder / name).pose.position.shape == (3,)


def test_the_strip_shows_five_bands(tmp_path: Path) -> None:
    for name in ("first.jpg", "second.jpg", "poses.json"):
        shutil.copy(EXAMPLES / "street" / name, tmp_path / name)
    make_strip = runpy.run_path(str(EXAMPLES / "make_strip.py"))["make_strip"]
    header = read_header(make_strip(tmp_path, 256))
    assert (header.height, header.width) == (5 * 64 + 4 * 4, 256)


def test_the_walk_is_what_view_makes_now() -> None:
    """After a change of its scripts or its rules the page is made again: see examples/README.md."""
    page = (EXAMPLES / "street" / "walk.html").read_text(encoding="utf-8")
    (script,) = re.findall(r'<script type="module">(.*?)</script>', page, re.DOTALL)
    assert script.startswith(module_code())


BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```", re.M | re.S)


@pytest.mark.parametrize("document", ["README.md", "docs/python.md"])
def test_every_example_runs(document: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of Python, in their order, and in the documentation of the library the commands between them."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    ran = 0
    for language, text in BLOCK.findall((ROOT / document).read_text(encoding="utf-8")):
        if language == "python":
            exec(compile(text, document, "exec"), {})  # noqa: S102 - our own documentation
            ran += 1
        elif document == "docs/python.md":
            cli.main(shlex.split(text)[1:], standalone_mode=False)
    assert ran > 0
    assert all(video.stat().st_size > 0 for video in tmp_path.glob("*.mp4"))


def test_importing_the_package_imports_nothing_else() -> None:
    program = "import sys, omnisyn_cli; print(*(name for name in sys.modules if name.startswith('omnisyn_cli')))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["omnisyn_cli"]


def test_every_name_is_there_and_no_other() -> None:
    homes = {name: home for home in (api, verbs_that_compare) for name in home.__all__}
    assert sorted(omnisyn.__all__) == sorted(homes)
    for name, home in homes.items():
        assert getattr(omnisyn, name) is getattr(home, name)
        assert name in dir(omnisyn)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        omnisyn.nothing  # noqa: B018


def test_known_depth_makes_the_true_frames(tmp_path: Path) -> None:
    poses = [posed((0, 0, 0.6)), posed((0, 0, -0.6))]
    views = omnisyn.read_views(write_hall(tmp_path, poses, (128, 256)), tmp_path / "poses.json")
    frames = list(omnisyn.make_frames(views, 3, "balanced", size=SIZE))
    assert ws_psnr(frames[1], hall_image(posed((0, 0, 0)))) > 40
    (tmp_path / "frames").mkdir()
    omnisyn.write_video(tmp_path / "frames", frames)
    for frame, path in zip(frames, sorted((tmp_path / "frames").iterdir()), strict=True):
        np.testing.assert_allclose(read_panorama(path).image, frame, atol=0.5 / 255 + 1e-6)


def test_what_cannot_be_used_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="one frame or more"):
        omnisyn.write_video(tmp_path / "none.mp4", [])
    with pytest.raises(ValueError, match="preset of fast"):
        list(omnisyn.make_frames([hall_view(posed((0, 0, z))) for z in (0.5, -0.5)], 3, "hasty"))


def test_a_single_name_is_no_list_of_panoramas(tmp_path: Path) -> None:
    for verb in (
        lambda: omnisyn.read_views("a.jpg", "p.json"),
        lambda: omnisyn.interpolate("a.jpg", "p.json", "o.mp4"),
    ):
        with pytest.raises(InputError, match=r"got the single name 'a\.jpg'"):
            verb()


@pytest.mark.parametrize("size", ["128x64", (128, 64), (64, 128)])
def test_sizes_are_names_or_both_numbers(tmp_path: Path, size: str | tuple[int, int]) -> None:
    images = write_hall(tmp_path, [posed((0, 0, 0.3)), posed((0, 0, -0.3))], (32, 64))
    poses = tmp_path / "poses.json"
    frames = omnisyn.make_frames(omnisyn.read_views(images, poses), 2, "fast", size=size)
    assert next(frames).shape == (64, 128, 3)
    made = omnisyn.interpolate([str(image) for image in images], str(poses), str(tmp_path / "o"), frames=2, size=size)
    assert made.plan.size == (64, 128)
    assert repr(made).startswith(f"Summary({tmp_path / 'o'}: 2 png images of 128x64 in ")
    assert "\n" not in repr(made)


@pytest.mark.parametrize("size", ["64x128", "64", (64, 64), (1, 2, 3), "0x0"])
def test_a_size_that_is_none_says_what_is(size: str | tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="twice as wide as high, such as 2048x1024"):
        list(omnisyn.make_frames([hall_view(posed((0, 0, z))) for z in (0.5, -0.5)], 3, size=size))  # type: ignore[arg-type]


def test_a_view_is_shown_in_a_line() -> None:
    assert repr(hall_view(posed((0, 0.25, -1)))) == "View(128x64 at (0, 0.25, -1) m, with depth)"


def test_help_lists_every_option_with_its_type() -> None:
    text = pydoc.render_doc(omnisyn.interpolate, renderer=pydoc.plaintext)
    for field in fields(InterpolationJob):
        assert re.search(rf"\b{field.name}: .*", text), field.name
    assert "frames: int | None = None" in text or "frames: Optional[int] = None" in text
    assert "one of :data:`omnisyn_cli.pipeline.presets.PRESETS`" in text


CAMERAS = Path(__file__).parents[1] / "docs" / "cameras.md"
CAMERA_SIZE = (128, 256)
CHEAP = ["--frames", "3", "--preset", "fast", "--threads", "2"]
COMMANDS = commands(CAMERAS)


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
    rendered = [
        np.rint(render_panorama(scene, pose, CAMERA_SIZE, threads=2)[0] * 255).astype(np.uint8) for pose in poses
    ]
    frames = [cv2.resize(picture, (256, 144), interpolation=cv2.INTER_CUBIC) for picture in rendered]
    with open_video(folder / "walk.mp4", size=(144, 256), fps=1, crf=8) as sink:
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
    with wave.open(str(folder / "song.wav"), "wb") as song:
        song.setparams((1, 2, 8000, 0, "NONE", ""))
        song.writeframes(bytes(2 * 8000))
    (folder / "cars").rename(folder / "street")
    (folder / "places.csv").write_text("\n".join(rows) + "\n")
    (folder / "model").mkdir()
    (folder / "model" / "images.txt").write_text("\n".join(model) + "\n")
    (folder / "model" / "cameras.txt").write_text("1 EQUIRECTANGULAR 256 128 256 128\n")
    return folder


def test_the_page_has_a_section_for_every_family() -> None:
    text = CAMERAS.read_text(encoding="utf-8")
    for family in ("Ricoh Theta", "Insta360", "GoPro MAX", "Telephone", "DSLR", "Street-view car"):
        assert f"\n## {family}" in text


@pytest.mark.parametrize("words", COMMANDS, ids=[" ".join(words) for words in COMMANDS])
def test_a_command_of_the_page_runs(folder: Path, words: list[str], omnisyn: Omnisyn, monkeypatch) -> None:
    """In the order of the page; small and cheap where that says nothing."""
    monkeypatch.chdir(folder)
    for earlier in COMMANDS[: COMMANDS.index(words)]:  # which another process of the tests may have run
        made = earlier[earlier.index("-o") + 1]
        is_named = made in words or Path(made).parent.name in words
        if is_named and made != words[words.index("-o") + 1] and not (folder / made).exists():
            run_small(omnisyn, earlier)
    run_small(omnisyn, words)
    assert (folder / words[words.index("-o") + 1]).stat().st_size > 0


def run_small(omnisyn: Omnisyn, words: list[str]) -> None:
    size = ["--size", "64x36" if "flat" in words else "64x32"]
    more = [*CHEAP, *size, "--overwrite"] if words[0] == "interpolate" else ["--overwrite"]
    omnisyn.made(*words, *more)
