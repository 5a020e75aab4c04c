"""Files that want more than they are given: memory, names outside their folder, a shell, a model nobody asked for."""

import ast
import json
import sys
import zlib
from functools import partial
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

import omnisyn_cli
from cli.cli_samples import Omnisyn, folder_arguments, pair_arguments, start_cli, write_pair
from interpolation_samples import Hall, edit_poses
from omnisyn_cli.errors import ImageError, InputError, PoseError
from omnisyn_cli.interpolation.describe import describe_file
from omnisyn_cli.io import MAX_PIXELS, read_depth, read_panorama, write_image
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.poses.formats import import_poses
from omnisyn_cli.poses.formats.files import ImportOptions
from omnisyn_cli.runtime.models import find_model
from process_limits import STATUS, memory_taken

SOURCE = Path(omnisyn_cli.__file__).parent


def png_that_says(path: Path, width: int, height: int, rows: int = 1) -> Path:
    """A PNG whose header promises more than there is: right checksums, ``rows`` rows of zeros."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return len(body).to_bytes(4, "big") + name + body + zlib.crc32(name + body).to_bytes(4, "big")

    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 2, 0, 0, 0])
    packer, packed = zlib.compressobj(9), b""
    for _ in range(rows):
        packed += packer.compress(bytes(min(1 + 3 * width, 1 << 20)))
    packed += packer.flush()
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b""))
    return path


def wide_exr(path: Path, channels: int = 3, full: tuple[int, int] = (16, 32), **tags: object) -> Path:
    """An EXR of 16×32 stored pixels with many channels, or with a display window of any size."""
    spec = OpenImageIO.ImageSpec(32, 16, channels, "float")
    spec.full_height, spec.full_width = full
    for name, value in tags.items():
        spec[name] = value
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec)
    assert writer.write_image(np.zeros((16, 32, channels), np.float32))
    assert writer.close()
    return path


def refuse(image: Path, words: str, *, depth: bool = False, **limits: int) -> None:
    """Expect that a panorama, or a depth file, is refused with these words."""
    with pytest.raises(ImageError, match=words):
        (read_depth if depth else read_panorama)(image, **limits)


@pytest.mark.skipif(not STATUS.exists(), reason="nobody tells the peak of memory there")
def test_memory_that_is_taken_shows_even_if_it_is_given_back() -> None:
    assert 64 << 20 < memory_taken(np.ones, 96 << 20, np.uint8) < 128 << 20


@pytest.mark.parametrize("depth", [False, True])
@pytest.mark.parametrize("size", [(100_000, 50_000), (2**31 - 2, 2**30 - 1), (MAX_PIXELS // 8192 * 2, 16384)])
def test_a_gigapixel_header_is_refused_before_memory_is_taken(tmp_path, size, depth) -> None:
    image = png_that_says(tmp_path / "a.png", *size)
    assert memory_taken(partial(refuse, image, "expected", depth=depth)) < 64 << 20


def test_a_window_or_tags_of_a_giant_sphere_are_refused(tmp_path: Path) -> None:
    tags = {"GPano:FullPanoWidthPixels": 2_000_000, "GPano:FullPanoHeightPixels": 1_000_000,
            "GPano:CroppedAreaImageWidthPixels": 32, "GPano:CroppedAreaImageHeightPixels": 16}  # fmt: skip
    for image in (
        wide_exr(tmp_path / "window.exr", full=(500_000, 1_000_000)),
        wide_exr(tmp_path / "tags.exr", **tags),
    ):
        assert memory_taken(refuse, image, "expected at most 268,435,456 pixels") < 64 << 20


def test_thousands_of_channels_are_refused(tmp_path: Path) -> None:
    image = wide_exr(tmp_path / "a.exr", channels=900)
    refuse(image, r"at most 2,048 samples, got 900 channels of 32×16", max_pixels=512)
    refuse(image, "900 channels", depth=True, max_pixels=512)


def test_a_decompression_bomb_is_stopped_by_max_pixels(tmp_path: Path) -> None:
    """Half a megabyte… of zeros would be 100 MB of samples and 400 MB of floats."""
    bomb = png_that_says(tmp_path / "a.png", 8192, 4096, rows=4096)
    assert bomb.stat().st_size < 400_000
    words = r"at most 1,000,000 pixels, got 8192×4096 = 33,554,432; .*--max-pixels"
    assert memory_taken(partial(refuse, bomb, words, max_pixels=1_000_000)) < 64 << 20


def test_max_pixels_is_heeded_by_the_plan_and_by_the_command_line(tmp_path: Path, omnisyn: Omnisyn) -> None:
    hall = Hall(tmp_path, write_pair(tmp_path))
    assert hall.plan(max_pixels=512).size == (16, 32)
    hall.refuses(ImageError, "at most 511 pixels, got 32×16", max_pixels=511)
    for words in (folder_arguments(tmp_path, hall.images), ["info", hall.images[0]]):
        result = omnisyn.ended(3, *words, "--max-pixels", 511)
        assert "at most 511 pixels" in result.out + result.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd", "x/../../secret.png", "C:\\secret.png"])
def test_pose_files_reach_nothing_outside_their_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    write_image(tmp_path / "secret.png", np.zeros((4, 8, 3), np.uint8))
    entry = {"position": [0, 0, 0], "rotation": [1, 0, 0, 0]}
    for panoramas in ({name: entry}, {"a.png": {**entry, "depth": name}}, {"a.png": {**entry, "mask": name}}):
        (folder / "poses.json").write_text(json.dumps({"version": 1, "panoramas": panoramas}))
        with pytest.raises(PoseError, match="expected"):
            read_poses(folder / "poses.json")


def scene_beside_a_picture(tmp_path: Path, key: str) -> tuple[Path, Hall, Path]:
    """A folder with panoramas, and outside of it a picture that could be their depth or mask."""
    folder, outside = tmp_path / "scene", tmp_path / "outside.png"
    folder.mkdir()
    write_image(outside, np.full((16, 32), 255, np.uint8 if key == "mask" else np.uint16))
    return folder, Hall(folder, write_pair(folder)), outside


@pytest.mark.parametrize("key", ["depth", "mask"])
def test_companions_of_a_panorama_lie_outside_only_if_allowed(tmp_path: Path, key: str) -> None:
    folder, hall, outside = scene_beside_a_picture(tmp_path, key)
    for name in ("../outside.png", str(outside)):
        edit_poses(folder, lambda panoramas, name=name: panoramas["a.png"].update({key: name}))
        hall.refuses(PoseError, "--allow-outside")
        assert getattr(hall.plan(allow_outside=True).entries[0], key).samefile(outside)


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
@pytest.mark.parametrize("key", ["depth", "mask"])
def test_a_link_leads_outside_only_if_that_is_allowed(tmp_path: Path, key: str) -> None:
    """Neither a link to a file, nor one to a folder with it, is a way around ``--allow-outside``."""
    folder, hall, outside = scene_beside_a_picture(tmp_path, key)
    (folder / "link.png").symlink_to(outside)
    (folder / "up").symlink_to(tmp_path)
    (folder / "inside.png").symlink_to(folder / "a.png")
    for name in ("link.png", "up/outside.png"):
        edit_poses(folder, lambda panoramas, name=name: panoramas["a.png"].update({key: name}))
        hall.refuses(PoseError, "a link that leads out of it; .*--allow-outside")
        assert getattr(hall.plan(allow_outside=True).entries[0], key).samefile(outside)
    edit_poses(folder, lambda panoramas: panoramas["a.png"].update({key: "inside.png"}))
    assert getattr(read_poses(folder / "poses.json").of("a.png"), key) == folder / "inside.png"


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
@pytest.mark.parametrize("place", ["-o", "--save-frames", "--save-confidence", "--view", "--mask", "--poses", "image"])
def test_links_in_a_circle_are_named_in_one_line(tmp_path: Path, omnisyn: Omnisyn, place: str) -> None:
    images = write_pair(tmp_path)
    circle = tmp_path / {"--view": "c.html", "--save-frames": "c"}.get(place, "c.mp4")
    circle.symlink_to(circle)
    named = [circle, images[1]] if place == "image" else images
    more = () if place == "image" else (place, circle, "--mask", images[1])[: 4 if place == "--mask" else 2]
    assert str(circle) in omnisyn.refused(*folder_arguments(tmp_path, named, *more))


def test_foreign_poses_reach_outside_only_if_allowed(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    write_image(tmp_path / "a.png", np.zeros((4, 8, 3), np.uint8))
    (folder / "places.csv").write_text("image,lat,lng,heading\n../a.png,48,11,90\n")
    with pytest.raises(PoseError, match="--allow-outside"):
        import_poses([folder / "places.csv"], "auto", ImportOptions())
    _, imported = import_poses([folder / "places.csv"], "auto", ImportOptions(allow_outside=True))
    assert imported.views[0].image is not None


def test_a_model_is_loaded_by_its_hash_or_by_the_name_of_its_file(tmp_path: Path) -> None:
    """A manifest cannot make the program load a file that it was not made with, wherever it lies."""
    outside = tmp_path / "evil.onnx"
    outside.write_bytes(b"evil")
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "manifest.toml").write_text(
        'version = 1\n[[models]]\nname = "m"\nrole = "depth"\nvariant = "v"\nfile = "../evil.onnx"\n'
        f'sha256 = "{"0" * 64}"\nsize = [4, 8]\nparameters = 1\ntraining = "t"\nlicence = "l"\n'
    )
    with pytest.raises(InputError, match="sha256"):
        find_model("m", folder)
    assert find_model(str(outside), folder) == outside


def test_a_long_or_impossible_name_is_refused_in_one_line(omnisyn: Omnisyn, tmp_path: Path) -> None:
    images = write_pair(tmp_path)
    long = tmp_path / ("x" * 300 + ".mp4")
    for words in (pair_arguments(tmp_path, images, long), ["info", long], ["models", long]):
        result = omnisyn(*words)
        assert result.code in (2, 3)
        assert "Traceback" not in result.err


@pytest.mark.skipif(sys.platform == "win32", reason="no such names there")
@pytest.mark.parametrize("name", ["a'b\"c ;touch gone $(touch gone) `touch gone`|x&", "-i --rm ä 日本 %d"])
def test_names_are_never_read_by_a_shell(tmp_path: Path, name: str) -> None:
    """A video with such a name is made by ffmpeg and described by ffmpeg; nothing else happens."""
    images = write_pair(tmp_path)
    before = {file.name for file in tmp_path.iterdir()}
    words = ["interpolate", "--poses", "poses.json", "-o", f"{name}.mp4", "--frames", 2, "--threads", 1,
             "--encoder-preset", "ultrafast", "-q", "--", *(image.name for image in images)]  # fmt: skip
    process = start_cli(*words, folder=tmp_path)
    assert (process.communicate(timeout=300)[1], process.returncode) == (b"", 0)
    assert {file.name for file in tmp_path.iterdir()} == before | {f"{name}.mp4"}
    assert describe_file(tmp_path / f"{name}.mp4")["spherical"]["version_1"]


def test_no_code_calls_a_shell_or_runs_what_it_reads() -> None:
    forbidden = {"os.system", "os.popen", "eval", "exec", "subprocess.getoutput", "subprocess.getstatusoutput"}
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                assert ast.unparse(node.func) not in forbidden, f"{path}:{node.lineno}: {ast.unparse(node)}"
                assert not any(word.arg == "shell" for word in node.keywords), f"{path}:{node.lineno} names a shell"
            names = [alias.name for alias in node.names] if isinstance(node, (ast.Import, ast.ImportFrom)) else []
            assert not {"pickle", "marshal", "shelve"} & set(names), f"{path}: reads what can run code"
