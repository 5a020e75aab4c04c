"""``describe_file`` and ``omnisyn info`` tell what is in a file, and go on after one that cannot be used."""

import json
import os

import cv2
import numpy as np
import pytest
from io_samples import smooth_image, write_with

from omnisyn_cli.errors import ImageError
from omnisyn_cli.interpolation.describe import describe_file
from omnisyn_cli.io import open_video, write_depth

GPS = {
    "GPS:Latitude": ("float[3]", (48.0, 30.0, 36.0)),
    "GPS:LatitudeRef": "S",
    "GPS:Longitude": ("float[3]", (11.0, 0.0, 0.0)),
    "GPS:LongitudeRef": "E",
}


@pytest.fixture
def folder(tmp_path):
    write_with(tmp_path / "a.jpg", smooth_image(), **GPS, **{"GPano:PoseHeadingDegrees": 12.0})
    depth = np.full((4, 8), 2.0, np.float32)
    depth[0] = np.inf
    write_depth(tmp_path / "a_depth.exr", depth)
    entry = {"rotation": [1, 0, 0, 0]}
    poses = {
        "a.jpg": {**entry, "position": [0, 0, 0], "depth": "a_depth.exr"},
        "b.jpg": {**entry, "position": [0, 3, 4]},
    }
    (tmp_path / "poses.json").write_text(json.dumps({"version": 1, "panoramas": poses}))
    with open_video(tmp_path / "v.mp4", size=(32, 64), fps=10, preset="ultrafast") as sink:
        for _ in range(5):
            sink.write(smooth_image())
    return tmp_path


def test_a_panorama_is_described(folder):
    seen = describe_file(folder / "a.jpg")
    assert (seen["kind"], seen["width"], seen["height"], seen["usable"]) == ("panorama", 64, 32, True)
    assert seen["gps"] == {"latitude": pytest.approx(-48.51), "longitude": 11.0}
    assert seen["gpano"] == {"PoseHeadingDegrees": 12.0}


def test_a_panorama_too_small_for_a_surface_is_not_usable(tmp_path):
    write_with(tmp_path / "dot.png", smooth_image()[:1, :2])
    seen = describe_file(tmp_path / "dot.png")
    assert (seen["usable"], seen["width"]) == (False, 2)
    assert "at least 4×2, got 2×1" in seen["problem"]


def test_a_panorama_without_a_visible_pixel_is_not_usable(tmp_path):
    cv2.imwrite(str(tmp_path / "clear.png"), np.zeros((32, 64, 4), np.uint8))
    assert not describe_file(tmp_path / "clear.png")["usable"]


@pytest.mark.parametrize(("reference", "sign"), [(0, 1), (1, -1), (2, 1), (3, -1)])
def test_altitudes_below_the_sea_and_below_the_ellipsoid_are_negative(tmp_path, reference, sign):
    tags = {**GPS, "GPS:Altitude": 5.0, "GPS:AltitudeRef": ("uint8", reference)}
    write_with(tmp_path / "deep.jpg", smooth_image(), **tags)
    assert describe_file(tmp_path / "deep.jpg")["gps"]["altitude"] == sign * 5.0


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_a_pipe_is_called_one(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(ImageError, match="got a device or a pipe"):
        describe_file(tmp_path / "pipe.png")


def test_depth_is_described(folder):
    seen = describe_file(folder / "a_depth.exr")
    assert (seen["kind"], seen["nearest_metres"], seen["infinite_share"]) == ("depth", 2.0, 0.25)


def test_poses_are_described(folder):
    seen = describe_file(folder / "poses.json")
    assert seen["steps_metres"] == [5.0]
    assert [(row["image_exists"], row["depth_exists"]) for row in seen["panoramas"]] == [(True, True), (False, None)]


def test_zero_has_no_sign(tmp_path, omnisyn):
    """As the first place of a tour has by its latitude."""
    place = {"latitude": 48.0, "longitude": 11.0, "altitude": 5.0, "heading": 0.0}
    (tmp_path / "poses.json").write_text(json.dumps({"version": 1, "panoramas": {"a.jpg": place}}))
    assert "position 0, 0, 0, image" in omnisyn("info", tmp_path / "poses.json").out


def test_poses_with_depth_outside_of_their_folder_are_described_if_allowed(folder, omnisyn):
    (folder / "poses").mkdir()
    text = (folder / "poses.json").read_text().replace("a_depth.exr", "../a_depth.exr")
    (folder / "poses" / "poses.json").write_text(text)
    words = ("info", folder / "poses" / "poses.json")
    assert "--allow-outside" in omnisyn.ended(3, *words).err
    assert omnisyn.json(*words, "--allow-outside")[0]["panoramas"][0]["depth_exists"] is True


def test_a_video_is_described(folder):
    seen = describe_file(folder / "v.mp4")
    assert (seen["codec"], seen["width"], seen["height"], seen["fps"]) == ("h264", 64, 32, 10.0)
    assert seen["duration_seconds"] == pytest.approx(0.5)
    assert seen["colour"][:2] == ["tv", "bt709"]
    assert seen["spherical"]["version_1"]
    assert seen["spherical"]["version_2"]


def test_info_goes_on_after_errors_and_ends_with_exit_code_3(folder, omnisyn):
    (folder / "text.mp4").write_text("no video")
    write_with(folder / "tall.png", smooth_image(64, 32))
    names = ["none.png", "text.mp4", "tall.png", "a.jpg", "poses.json", "v.mp4", "a_depth.exr"]
    result = omnisyn.ended(3, "info", *(folder / name for name in names))
    assert "no such file" in result.err
    assert "text.mp4: expected a video" in result.err
    assert "usable: no" in result.out
    assert "steps metres: 5" in result.out


def test_info_writes_json_that_json_can_read(folder, omnisyn):
    found = omnisyn.json("info", *(folder / name for name in ("a.jpg", "poses.json", "v.mp4", "a_depth.exr")))
    assert [seen["kind"] for seen in found] == ["panorama", "poses", "video", "depth"]
    assert json.loads(omnisyn.ended(3, "info", "--json", folder / "none").out)[0]["ok"] is False
