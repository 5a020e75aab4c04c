"""``omnisyn poses import`` and ``export``: what was assumed is said, nothing is overwritten, help is instant."""

import json
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from cli.cli_samples import Omnisyn, listing, pair_arguments, write_pair
from omnisyn_cli.cli import poses as commands
from omnisyn_cli.interpolation.inputs import named_tour
from omnisyn_cli.interpolation.planning import duration
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.poses.formats import IMPORT_FORMATS
from omnisyn_cli.poses.formats.files import CAMERA_AXES, WORLD_UP
from omnisyn_cli.poses.formats.writers import EXPORT_FORMATS

TABLE = "image,lat,lng,heading\na.png,48.1,11.5,0\nb.png,48.10001,11.5,90\n"


def table(folder: Path) -> Path:
    path = folder / "walk.csv"
    path.write_text(TABLE, encoding="utf-8")
    return path


def placed_panorama(path: Path) -> Path:
    """A panorama with EXIF GPS and a heading, in a folder that is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    spec = OpenImageIO.ImageSpec(32, 16, 3, "uint8")
    for name, value, half in (("GPS:Latitude", (48.0, 8.0, 0.0), "N"), ("GPS:Longitude", (11.0, 30.0, 0.0), "E")):
        spec.attribute(name, "float[3]", value)
        spec[f"{name}Ref"] = half
    spec["GPano:PoseHeadingDegrees"] = 0.0
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec)
    assert writer.write_image(np.full((16, 32, 3), 128, np.uint8))
    assert writer.close()
    return path


def test_choices_are_those_of_the_library() -> None:
    """They are written out twice, because help should not load the library."""
    assert set(commands.IMPORT_FORMATS) == {"auto", *IMPORT_FORMATS}
    assert set(commands.CAMERA_AXES) == set(CAMERA_AXES)
    assert set(commands.UP_AXES) == {*WORLD_UP, "cameras"}
    assert commands.EXPORT_FORMATS == EXPORT_FORMATS


def test_every_subcommand_is_listed_and_loads(omnisyn: Omnisyn) -> None:
    result = omnisyn("poses", "--help")
    places = [result.out.index(f"  {name}") for name in ("import", "export", "check", "refine", "estimate")]
    assert places == sorted(places)
    assert len(places) == len(commands.poses.commands)


def test_import_says_what_it_assumed(tmp_path: Path, omnisyn: Omnisyn) -> None:
    result = omnisyn("poses", "import", table(tmp_path), "-o", tmp_path / "poses.json")
    assert (result.code, result.out) == (0, "")
    assert "altitudes: none given" in result.err
    assert "images: 'a.png', 'b.png' not found" in result.err
    assert result.err.splitlines()[-1] == f"{tmp_path / 'poses.json'}: 2 panoramas from table"
    second = read_poses(tmp_path / "poses.json").of("b.png").pose
    np.testing.assert_allclose(second.rotation @ [0, 0, -1], [1, 0, 0], atol=1e-6)
    assert second.position[2] == pytest.approx(-1.112, abs=1e-3)


def test_values_may_begin_with_a_minus(tmp_path: Path, omnisyn: Omnisyn) -> None:
    arguments = ["poses", "import", table(tmp_path), "-o", tmp_path / "poses.json"]
    result = omnisyn.made(*arguments, "--origin", "-48.1,-11.5,-3")
    assert "origin: latitude -48.1, longitude -11.5, altitude -3 m" in result.err
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 -2 1 a.png\n\n", encoding="utf-8")
    arguments = ["poses", "import", tmp_path / "images.txt", "-o", tmp_path / "up.json"]
    omnisyn.made(*arguments, "--up", "-z")
    np.testing.assert_allclose(read_poses(tmp_path / "up.json").of("a.png").pose.position, [0, -2, 0])


def test_quiet_is_quiet(tmp_path: Path, omnisyn: Omnisyn) -> None:
    assert omnisyn.quiet("poses", "import", table(tmp_path), "-q", "-o", tmp_path / "poses.json").out == ""


def test_nothing_is_overwritten_unasked(tmp_path: Path, omnisyn: Omnisyn) -> None:
    output = tmp_path / "poses.json"
    output.write_text("mine", encoding="utf-8")
    arguments = ["poses", "import", table(tmp_path), "-o", output]
    assert "--overwrite" in omnisyn.refused(*arguments)
    assert output.read_text(encoding="utf-8") == "mine"
    omnisyn.made(*arguments, "--overwrite")
    assert json.loads(output.read_text(encoding="utf-8"))["version"] == 1


def test_images_of_one_name_have_folders_or_are_copied_under_two(tmp_path: Path, omnisyn: Omnisyn) -> None:
    sources = [placed_panorama(tmp_path / "g" / name / "R0010001.JPG") for name in ("a", "b")]
    output = tmp_path / "out" / "poses.json"
    output.parent.mkdir()
    beside = tmp_path / "g" / "poses.json"
    omnisyn.made("poses", "import", *sources, "-o", beside)
    assert list(read_poses(beside).panoramas) == ["a/R0010001.JPG", "b/R0010001.JPG"]
    assert named_tour([tmp_path / "g"]).images == tuple(sources)
    omnisyn.made("poses", "import", *sources, "-o", output, "--copy-images")
    assert list(listing(output.parent)) == ["a_R0010001.JPG", "b_R0010001.JPG", "poses.json"]
    assert list(read_poses(output).panoramas) == ["a_R0010001.JPG", "b_R0010001.JPG"]


@pytest.mark.parametrize("name", ["none", "walk.csv"])
def test_a_folder_of_panoramas_has_to_be_one(tmp_path: Path, omnisyn: Omnisyn, name: str) -> None:
    source = table(tmp_path)
    result = omnisyn.refused("poses", "import", source, "-o", tmp_path / "out.json", "--images", tmp_path / name)
    assert f"{tmp_path / name}: expected a readable folder, got '" in result


def test_export_names_the_folder_in_which_it_looked(tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_pair(tmp_path)
    (tmp_path / "images").mkdir()
    arguments = ["poses", "export", tmp_path / "poses.json", "--format", "nerfstudio", "-o", tmp_path / "t.json"]
    result = omnisyn.refused(*arguments, "--images", tmp_path / "images")
    assert f"expected the panorama 'a.png' in '{tmp_path / 'images'}', for its size, got none" in result


@pytest.mark.parametrize("command", ["import", "export"])
def test_not_even_overwriting_reaches_the_source(tmp_path: Path, omnisyn: Omnisyn, command: str) -> None:
    source = table(tmp_path)
    if command == "export":
        assert omnisyn("poses", "import", source, "-o", tmp_path / "poses.json").code == 0
        source = tmp_path / "poses.json"
    before = source.read_bytes()
    words = [source, "-o", source, "--overwrite", *(["--format", "tum"] if command == "export" else [])]
    assert "inputs that are not overwritten" in omnisyn.refused("poses", command, *words)
    assert source.read_bytes() == before


def test_errors_are_one_line_and_leave_nothing_behind(tmp_path: Path, omnisyn: Omnisyn) -> None:
    source = tmp_path / "walk.csv"
    source.write_text(TABLE + "c.png,1,2,north\n", encoding="utf-8")
    result = omnisyn.refused("poses", "import", source, "-o", tmp_path / "poses.json")
    assert f"{source}:4: expected numbers (heading)" in result


@pytest.mark.parametrize(
    "words", ["--origin north", "--origin 91,0", "--origin 1,2,inf", "--origin 1", "--up x", "--format bundler"]
)
def test_wrong_usage_is_2(tmp_path: Path, omnisyn: Omnisyn, words: str) -> None:
    omnisyn.misused("poses", "import", table(tmp_path), "-o", tmp_path / "poses.json", *words.split())


def test_exported_and_imported_poses_make_the_same_plan(
    tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A whole way round, through a COLMAP model, to a command that uses the result."""
    monkeypatch.setattr(duration, "probe", lambda: 1e-3)  # how fast the machine is may change between two plans
    images = write_pair(tmp_path)
    poses = tmp_path / "poses.json"
    omnisyn.made("poses", "export", poses, "--format", "colmap", "-o", tmp_path / "model")
    arguments = pair_arguments(tmp_path, images, "out.mp4", "--dry-run", "--depth", "matching")
    before = omnisyn.made(*arguments).out
    again = omnisyn.made("poses", "import", tmp_path / "model", "-o", poses, "--overwrite")
    assert "COLMAP knows no scale" in again.err
    assert omnisyn.made(*arguments).out == before


def test_the_documentation_knows_every_format_and_option() -> None:
    text = (Path(__file__).parents[2] / "docs" / "poses.md").read_text(encoding="utf-8")
    for name in (*IMPORT_FORMATS, *EXPORT_FORMATS):
        assert f"`{name}`" in text
    for command in (commands.import_, commands.export):
        for parameter in command.params:
            long = parameter.opts[-1]
            assert not long.startswith("--") or long in text or long in {"--quiet", "--output"}, long


def test_the_table_of_the_documentation_is_understood(tmp_path: Path, omnisyn: Omnisyn) -> None:
    text = (Path(__file__).parents[2] / "docs" / "poses.md").read_text(encoding="utf-8")
    start = text.index("image,lat,lng")
    source = tmp_path / "walk.csv"
    source.write_text(text[start : text.index("```", start)], encoding="utf-8")
    assert omnisyn("poses", "import", source, "-o", tmp_path / "poses.json").code == 0
    assert list(read_poses(tmp_path / "poses.json").panoramas) == ["a.jpg", "b.jpg"]
