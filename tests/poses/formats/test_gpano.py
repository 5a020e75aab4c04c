"""GPano tags in copies of JPEGs: other readers find the pose, and nothing else of the file has changed."""

import io
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from omnisyn_cli.errors import ImageError, OutputPathError, PoseError
from omnisyn_cli.geometry.pose import Pose, heading_from_rotation, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.io.jpeg_metadata import with_properties
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, read_poses, write_poses
from omnisyn_cli.poses.formats.writers import export_poses
from poses.formats.foreign_samples import write_images
from poses.formats.test_pose_places import gps, imported, pano_pose

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
        with_properties(tmp_path / "a.jpg", data, ("GPano", GPANO[1:-1]), {"PoseHeadingDegrees": "0" * 3000})


@pytest.mark.parametrize("data", [b"", b"\x89PNG", b"\xff\xd8", b"\xff\xd8\xff\xe0\x00\x10JFIF"])
def test_no_jpeg(data: bytes) -> None:
    with pytest.raises(ImageError, match="expected a JPEG"):
        with_properties(Path("a.jpg"), data, ("GPano", GPANO[1:-1]), {})
