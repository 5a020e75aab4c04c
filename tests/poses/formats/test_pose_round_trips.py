"""What is written for another program comes back as it was: names, order and poses; GPano tags in copies of JPEGs."""

import io
import json
import math
from pathlib import Path
from unittest.mock import Mock
from xml.etree import ElementTree

import numpy as np
import pytest
from foreign_samples import axis_angle, imported, samples, write_images
from PIL import Image
from test_pose_places import gps, pano_pose

from omnisyn_cli.errors import ImageError, OutputPathError, PoseError, WriteError
from omnisyn_cli.geometry.pose import Pose, heading_from_rotation, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.interpolation.export.datasets import FACES
from omnisyn_cli.io.jpeg_metadata import with_gpano
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, read_poses, write_poses
from omnisyn_cli.poses.formats.colmap import colmap_rig_files
from omnisyn_cli.poses.formats.files import ImportedPoses
from omnisyn_cli.poses.formats.writers import EXPORT_FORMATS, export_poses, write_imported

OUTPUTS = {"colmap": "model", "nerfstudio": "transforms.json", "tum": "trajectory.tum"}

# Those that hold positions; tags in copies of photographs hold rotations and have tests of their own.
every_format = pytest.mark.parametrize("format_name", [name for name in EXPORT_FORMATS if name != "gpano"])


def turns() -> list[np.ndarray]:
    """Rotations, those that singularities love among them: none, tiny, half turns about every axis, any."""
    special = [(1e-12, 0, 0), (0, 1e-7, 0), (np.pi, 0, 0), (0, np.pi, 0), (0, 0, np.pi), (np.pi - 1e-9, 1e-9, 0)]
    return [np.eye(3), *(axis_angle(vector)[0] for vector in (*special, *(turn for turn, _, _ in samples(8))))]


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
    poses, output = written(tmp_path), tmp_path / OUTPUTS[format_name]
    for way in ("open", "write_text"):
        monkeypatch.setattr(Path, way, Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(WriteError, match=f"{output.name}: expected to write it, got 'No space"):
        export_poses(poses, output, format_name, size=(4, 8))
    assert not output.exists()


GPANO = "{http://ns.google.com/photos/1.0/panorama/}"
PACKET = (
    b'<?xpacket begin="\xef\xbb\xbf" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
    b'<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
    b'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" xmlns:dc="http://purl.org/dc/elements/1.1/" '
    b'GPano:PoseRollDegrees="7"><dc:title>Caf\xc3\xa9 &amp; bar</dc:title>'
    b"<GPano:PoseHeadingDegrees>12</GPano:PoseHeadingDegrees><GPano:StitchingSoftware>S</GPano:StitchingSoftware>"
    b"</rdf:Description></rdf:RDF></x:xmpmeta>" + b" " * 600 + b'<?xpacket end="w"?>'
)


def tagged_jpeg(path: Path, packet: bytes = b"", behind: bytes = b"") -> bytes:
    """A JPEG with EXIF and, if asked for, XMP and bytes behind the picture."""
    picture = np.random.default_rng(1).integers(0, 256, (32, 64, 3), np.uint8)
    exif = Image.Exif()
    exif[0x010F] = "A camera"
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", exif=exif, quality=90, **({"xmp": packet} if packet else {}))
    path.write_bytes(stream.getvalue() + behind)
    return path.read_bytes()


def other_parts(data: bytes) -> list[bytes]:
    """Every segment but XMP, and all from the picture on."""
    found, at = [data[:2]], 2
    while data[at + 1] != 0xDA:
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if not data[at + 4 : end].startswith(b"http://ns.adobe.com/xap/"):
            found.append(data[at:end])
        at = end
    return [*found, data[at:]]


def properties(path: Path) -> dict[str, str | None]:
    """XMP as Pillow hands it out, read by Python's own parser: attributes and elements of the descriptions."""
    with Image.open(path) as image:
        packet = image.info["xmp"]
    tree = ElementTree.fromstring(packet.split(b"?>", 1)[1].rsplit(b"<?", 1)[0])  # noqa: S314 - the test's own file
    found: dict[str, str | None] = {}
    for description in tree.iter("{http://www.w3.org/1999/02/22-rdf-syntax-ns#}Description"):
        for name, value in [*description.attrib.items(), *((node.tag, node.text) for node in description)]:
            assert name not in found
            found[name] = value
    return found


def exported(folder: Path, rotation: np.ndarray) -> Path:
    write_poses(folder / "poses.json", {"a.jpg": PosedPanorama(Pose(rotation, np.zeros(3)))})
    export_poses(read_poses(folder / "poses.json"), folder / "tagged", "gpano")
    return folder / "tagged" / "a.jpg"


@pytest.mark.parametrize("packet", [b"", PACKET, PACKET.replace(b" " * 600, b"")], ids=["none", "padded", "tight"])
def test_other_readers_find_the_pose_and_nothing_else_changes(tmp_path: Path, packet: bytes) -> None:
    before = tagged_jpeg(tmp_path / "a.jpg", packet, b"a second picture")
    copy = exported(tmp_path, rotation_from_heading(*map(math.radians, (200.5, -12.25, 3.75))))
    assert (tmp_path / "a.jpg").read_bytes() == before
    assert other_parts(copy.read_bytes()) == other_parts(before)
    assert len(copy.read_bytes()) == len(before) or b" " * 600 not in packet
    found = properties(copy)
    angles = [float(found[f"{GPANO}Pose{name}Degrees"] or "nan") for name in ("Heading", "Pitch", "Roll")]
    np.testing.assert_allclose(angles, (200.5, -12.25, 3.75), atol=1e-6)
    assert found[f"{GPANO}UsePanoramaViewer"] == "True"
    assert (found[f"{GPANO}FullPanoWidthPixels"], found[f"{GPANO}CroppedAreaTopPixels"]) == ("64", "0")
    if packet:
        assert found["{http://purl.org/dc/elements/1.1/}title"] == "Café & bar"
        assert found[f"{GPANO}StitchingSoftware"] == "S"


def test_the_program_reads_back_what_it_wrote(tmp_path: Path) -> None:
    write_images(tmp_path, ["a.jpg"], **gps(48.0, 11.5, 500.0), **pano_pose(1.0, 2.0, 3.0))
    rotation = rotation_from_heading(*map(math.radians, (300.0, 20.0, -8.0)))
    (view,) = imported(exported(tmp_path, rotation), expected="exif").views
    np.testing.assert_allclose(view.pose.rotation, rotation, atol=1e-6)


def test_a_crop_keeps_its_place(tmp_path: Path) -> None:
    whole = {"FullPanoWidthPixels": 4000, "FullPanoHeightPixels": 2000, "CroppedAreaTopPixels": 500}
    area = {"CroppedAreaImageWidthPixels": 4000, "CroppedAreaImageHeightPixels": 1000, "CroppedAreaLeftPixels": 0}
    tags = {f"GPano:{name}": value for name, value in {**whole, **area}.items()}
    write_images(tmp_path, ["a.jpg"], **tags)
    found = properties(exported(tmp_path, np.eye(3)))
    assert {name: found[f"{GPANO}{name}"] for name in whole} == {name: str(value) for name, value in whole.items()}


def test_heading_pitch_and_roll_are_those_of_the_rotation() -> None:
    """Of random rotations, of such that hardly turn, and straight up, where headings mean nothing."""
    rng = np.random.default_rng(0)
    some = [rotation_from_rotation_vector(scale * rng.standard_normal(3)) for scale in (1.0, 3.0, 1e-9) for _ in "1234"]
    for rotation in (*some, np.eye(3), rotation_from_heading(1.0, math.radians(90.0), 0.5)):
        angles = heading_from_rotation(rotation)
        assert 0.0 <= angles[0] < math.tau
        np.testing.assert_allclose(rotation_from_heading(*angles), rotation, atol=1e-7)


def test_what_cannot_be_tagged_is_refused(tmp_path: Path) -> None:
    tagged_jpeg(tmp_path / "a.jpg", PACKET)
    poses = PoseFile(tmp_path / "poses.json", {"a.jpg": PosedPanorama(Pose.identity())})
    with pytest.raises(OutputPathError, match="not overwritten"):
        export_poses(poses, tmp_path, "gpano", overwrite=True)
    with pytest.raises(PoseError, match=r"'b\.png' as a JPEG .* got another format"):
        export_poses(PoseFile(poses.path, {"b.png": PosedPanorama(Pose.identity())}), tmp_path / "out", "gpano")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("packet", "message"),
    [
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "a declaration of entities"),
        (b"<a>", "expected readable XMP"),
        (PACKET.replace(b"Caf", b"C" * 64000), "expected XMP of at most 65,533 bytes"),
    ],
)
def test_hostile_and_damaged_packets_are_refused(tmp_path: Path, packet: bytes, message: str) -> None:
    data = tagged_jpeg(tmp_path / "a.jpg", packet)
    with pytest.raises(ImageError, match=message):
        with_gpano(tmp_path / "a.jpg", data, {"PoseHeadingDegrees": "0" * 3000})


@pytest.mark.parametrize("data", [b"", b"\x89PNG", b"\xff\xd8", b"\xff\xd8\xff\xe0\x00\x10JFIF"])
def test_no_jpeg(data: bytes) -> None:
    with pytest.raises(ImageError, match="expected a JPEG"):
        with_gpano(Path("a.jpg"), data, {})
