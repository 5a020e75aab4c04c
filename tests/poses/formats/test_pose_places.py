"""Panoramas with a place on earth see a landmark where compass and horizon say, from EXIF and from tables."""

import math
from typing import Any

import numpy as np
import pytest
from foreign_samples import SIZE, imported, our_pixel, refuse, write_images, write_json, write_text

from omnisyn_cli.geometry.pose import Pose, rotation_angle
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.poses.registration.conventions import heading_angles
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

ORIGIN = (48.1, 11.5, 520.0)
PLACES = [(48.1, 11.5, 520.0, 93.0), (48.1003, 11.5004, 523.5, 270.5), (48.11, 11.48, 500.0, -15.0)]
LANDMARK = (48.1007, 11.4991, 560.0)


def ecef(latitude: float, longitude: float, altitude: float) -> np.ndarray:
    """Earth-centred coordinates, WGS84 by its two axes."""
    a, b = 6378137.0, 6356752.314245179
    phi, lam = math.radians(latitude), math.radians(longitude)
    normal = a**2 / math.hypot(a * math.cos(phi), b * math.sin(phi))
    ring = (normal + altitude) * math.cos(phi)
    return np.array([ring * math.cos(lam), ring * math.sin(lam), (normal * b**2 / a**2 + altitude) * math.sin(phi)])


def east_north_up(place: tuple[float, ...], seen_from: tuple[float, ...]) -> np.ndarray:
    phi, lam = math.radians(seen_from[0]), math.radians(seen_from[1])
    east = (-math.sin(lam), math.cos(lam), 0)
    up = (math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi))
    north = np.cross(up, east)
    return np.array([east, north, up]) @ (ecef(*place[:3]) - ecef(*seen_from[:3]))


def landmark_pixel(place: tuple[float, ...], heading: float) -> np.ndarray:
    """Where a level panorama at ``place`` sees the landmark: by its own compass and its own horizon."""
    east, north, up = east_north_up(LANDMARK, place)
    height, width = SIZE
    azimuth = (math.atan2(east, north) - math.radians(heading) + math.pi) % (2 * math.pi) - math.pi
    elevation = math.atan2(up, math.hypot(east, north))
    return np.array([(0.5 - elevation / math.pi) * height - 0.5, (0.5 + azimuth / (2 * math.pi)) * width - 0.5])


def check_landmark(poses: list[Pose], origin: tuple[float, float, float], pixels: float) -> None:
    east, north, up = east_north_up(LANDMARK, origin)
    for pose, (*place, heading) in zip(poses, PLACES, strict=True):
        seen = our_pixel(pose, np.array([east, up, -north]))
        np.testing.assert_allclose(seen, landmark_pixel(tuple(place), heading), atol=pixels)


def sexagesimal(angle: float) -> tuple[str, tuple[float, float, float]]:
    minutes, seconds = divmod(round(abs(angle) * 3600, 6), 60)
    return "float[3]", (minutes // 60, minutes % 60, seconds)


def gps(latitude: float, longitude: float, altitude: float) -> dict[str, Any]:
    return {
        "GPS:Latitude": sexagesimal(latitude), "GPS:LatitudeRef": "N" if latitude >= 0 else "S",
        "GPS:Longitude": sexagesimal(longitude), "GPS:LongitudeRef": "E" if longitude >= 0 else "W",
        "GPS:Altitude": abs(altitude), "GPS:AltitudeRef": int(altitude < 0),
    }  # fmt: skip


def pano_pose(heading: float, pitch: float | None = None, roll: float | None = None) -> dict[str, float]:
    tags = {"GPano:PoseHeadingDegrees": heading, "GPano:PosePitchDegrees": pitch, "GPano:PoseRollDegrees": roll}
    return {name: value for name, value in tags.items() if value is not None}


@pytest.mark.parametrize("origin", [None, (48.0, 11.0, 0.0)])
def test_exif(tmp_path, origin):
    """Degrees, minutes and seconds are 32-bit in OpenImageIO: 0.2 mm; headings too: 0.00002°."""
    for index, (*place, heading) in enumerate(PLACES):
        write_images(tmp_path, [f"{index}.jpg"], **gps(*place), **pano_pose(heading % 360))
    write_images(tmp_path, ["other.jpg"])
    result = imported(tmp_path, expected="exif", origin=origin)
    check_landmark([view.pose for view in result.views], origin or ORIGIN, pixels=2e-3)
    notes = " ".join(result.notes)
    assert "sea level" in notes
    assert "'other.jpg' without GPS" in notes
    assert "pitch and roll: taken as 0" in notes


@pytest.mark.parametrize("origin", [None, (47.0, 12.0, -100.0)])
def test_tables(tmp_path, origin):
    lines = [f"{index}.jpg;{lat!r};{lng!r};{alt};{heading}" for index, (lat, lng, alt, heading) in enumerate(PLACES)]
    table = write_text(tmp_path / "walk.csv", "Image;LAT;lng;elevation;Heading", *lines)
    rows = [
        {"pano_id": f"{index}", "location": {"lat": lat, "lng": lng}, "alt": alt, "heading": heading, "date": "2022-03"}
        for index, (lat, lng, alt, heading) in enumerate(PLACES)
    ]
    for source in (table, write_json(tmp_path / "walk.json", rows), write_json(tmp_path / "b.json", {"data": rows})):
        result = imported(source, expected="table", origin=origin)
        check_landmark([view.pose for view in result.views], origin or ORIGIN, pixels=1e-5)
    assert "ignored: columns 'date'" in result.notes


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_where_commas_do_not_separate(tmp_path, separator):
    header, row = ("image", "lat", "lng", "heading"), ("a,1.jpg", "48,13713", "-11,57538", "93,0")
    commas = write_text(tmp_path / "a.csv", *(separator.join(fields) for fields in (header, row)))
    points = write_text(tmp_path / "b.csv", ",".join(header), '"a,1.jpg",48.13713,-11.57538,93.0')
    (a,), (b,) = (imported(source, expected="table", origin=ORIGIN).views for source in (commas, points))
    assert a.name == b.name == "a,1.jpg"
    assert a.pose.almost_equals(b.pose)


def test_south_west_and_below_the_sea(tmp_path):
    write_images(tmp_path, ["a.jpg"], **gps(-33.5, -70.25, -12.5), **pano_pose(0.0))
    result = imported(tmp_path / "a.jpg", expected="exif")
    assert "origin: latitude -33.5, longitude -70.25, altitude -12.5 m; x east, −z north" in result.notes
    np.testing.assert_allclose(result.views[0].pose.position, 0, atol=1e-9)
    for name in ("Latitude", "Longitude"):
        tags = gps(-33.5, -70.25, 0.0)
        del tags[f"GPS:{name}Ref"]
        write_images(tmp_path, ["b.jpg"], **tags, **pano_pose(0.0))
        refuse(rf"b\.jpg: expected GPS {name}Ref \(on which half of the earth\), got none", tmp_path / "b.jpg")


def test_fractions_of_degrees_are_read_and_their_loss_of_digits_is_said(tmp_path):
    tags = gps(*ORIGIN) | {"GPS:Latitude": ("float[3]", (48.25, 0.0, 0.0)), "GPS:LatitudeRef": "S"}
    write_images(tmp_path, ["a.jpg"], **tags, **pano_pose(0.0))
    notes = imported(tmp_path, expected="exif").notes
    assert notes[0].startswith("origin: latitude -48.25, longitude 11.5,")
    assert any("half a metre" in note for note in notes)


@pytest.mark.parametrize("latitude", [90.0, -90.0, 0.0])
def test_poles_and_equator_are_no_special_places(tmp_path, latitude):
    rows = (f"a.jpg,{latitude},180,0", f"b.jpg,{latitude},-180,0")
    table = write_text(tmp_path / "t.csv", "image,lat,lng,heading", *rows)
    first, second = (view.pose for view in imported(table, expected="table").views)
    np.testing.assert_allclose(first.rotation, np.eye(3), atol=1e-12)
    assert second.almost_equals(first, metres=1e-6)


def test_pitch_lifts_the_centre_and_roll_turns_the_horizon_counter_clockwise(tmp_path):
    """Google: pitch is that of the image centre; as roll grows, the horizon rotates counter-clockwise in the image."""
    write_images(tmp_path, ["pitch.jpg"], **gps(*ORIGIN), **pano_pose(90.0, 30.0, 0.0))
    write_images(tmp_path, ["roll.jpg"], **gps(*ORIGIN), **pano_pose(90.0, 0.0, 20.0))
    lifted, rolled = (view.pose for view in imported(tmp_path, expected="exif").views)
    height, width = SIZE
    centre = (height / 2 - 0.5, width / 2 - 0.5)
    up_and_east = np.array([math.cos(math.pi / 6), math.sin(math.pi / 6), 0])
    np.testing.assert_allclose(our_pixel(lifted, up_and_east), centre, atol=1e-3)
    np.testing.assert_allclose(our_pixel(rolled, np.array([1.0, 0, 0])), centre, atol=1e-3)
    south = our_pixel(rolled, np.array([0, 0, 1.0]))  # on the right of the centre: its horizon rises
    assert south[0] == pytest.approx(height / 2 - 0.5 - 20 / 180 * height, abs=1e-3)
    assert south[1] == pytest.approx(0.75 * width - 0.5, abs=1e-3)


def test_programs_that_turn_the_horizon_clockwise_are_read_with_an_option(tmp_path):
    write_images(tmp_path, ["a.jpg"], **gps(*ORIGIN), **pano_pose(90.0, 10.0, 5.0))
    write_images(tmp_path, ["b.jpg"], **gps(*ORIGIN), **pano_pose(90.0, 10.0, -5.0))
    as_specified, reversed_ = (imported(tmp_path, expected="exif", roll=roll).views for roll in (None, "clockwise"))
    assert as_specified[0].pose.almost_equals(reversed_[1].pose)
    assert as_specified[1].pose.almost_equals(reversed_[0].pose)
    refuse("expected no --roll with format kitti", write_text(tmp_path / "a.txt", ""), name="kitti", roll="clockwise")


def camera_tags(make: str, model: str) -> dict[str, str]:
    return {"Make": make, "Model": model}


def test_null_island_is_no_place(tmp_path):
    """Insta360 Studio writes latitude and longitude 0 where there was no GPS."""
    write_images(tmp_path, ["a.jpg"], **gps(0.0, 0.0, 0.0), **pano_pose(0.0), **camera_tags("Insta360", "X3"))
    refuse("expected images with EXIF GPS, got none in 1 images", tmp_path)
    write_images(tmp_path, ["b.jpg"], **gps(*ORIGIN), **pano_pose(10.0))
    result = imported(tmp_path, expected="exif")
    assert [view.name for view in result.views] == ["b.jpg"]
    assert any("left out: 'a.jpg' without GPS" in note for note in result.notes)


# 7.4 m to the east, then 11.1 m to the north.
TRACK = [(48.1, 11.5, 520.0), (48.1, 11.5001, 520.0), (48.1001, 11.5001, 520.0)]


@pytest.mark.parametrize(
    "tags",
    [camera_tags("GoPro", "GoPro Max") | pano_pose(0.0, 0.0, 0.0), camera_tags("RICOH", "THETA V"),
     camera_tags("Insta360", "Insta360 X4") | pano_pose(0.0, 0.0, 0.0)],
    ids=["GoPro MAX", "Theta V", "X4"],
)  # fmt: skip
def test_where_pictures_tell_nothing_cameras_look_along_the_track(tmp_path, tags):
    """Plain grey pictures; the placeholder of a GoPro is no heading."""
    for index, place in enumerate(TRACK):
        write_images(tmp_path, [f"{index}.jpg"], **gps(*place), **tags)
    result = imported(tmp_path, expected="exif")
    forward = [view.pose.rotation @ [0, 0, -1] for view in result.views]
    np.testing.assert_allclose(forward, [[1, 0, 0], [0, 0, -1], [0, 0, -1]], atol=2e-3)
    notes = " ".join(result.notes)
    assert "taken to look along the track" in notes
    assert ("taken for placeholders" in notes) == ("GPano:PoseRollDegrees" in tags)


def geographic(position: np.ndarray) -> tuple[float, float, float]:
    """A place some metres east, up and −north of the origin, on a sphere through it."""
    east, up, south = position
    north_radius, east_radius = 6_367_000.0, 6_390_000.0 * math.cos(math.radians(ORIGIN[0]))
    return (
        ORIGIN[0] - math.degrees(south / north_radius), ORIGIN[1] + math.degrees(east / east_radius), ORIGIN[2] + up,
    )  # fmt: skip


@pytest.fixture(scope="module")
def street():
    """Poses and pictures of three panoramas."""
    scene = generate_scene("street", 101)
    poses = sample_path(scene, 101, 3)
    images = (render_panorama(scene, pose, (192, 384), threads=2)[0] for pose in poses)
    return poses, [np.rint(image * 255).astype(np.uint8) for image in images]


@pytest.mark.parametrize("headings", [(None, None, None), (True, None, None), (None, None, True)])
def test_headings_come_from_the_pictures(tmp_path, street, headings):
    """Of all three panoramas with the track of their places, or of those without one from their neighbours."""
    poses, pictures = street
    for index, (pose, picture, has_heading) in enumerate(zip(poses, pictures, headings, strict=True)):
        heading = math.degrees(heading_angles(pose.rotation)[0]) % 360
        tags = gps(*geographic(pose.position)) | (pano_pose(heading) if has_heading else {})
        write_images(tmp_path, [f"{index}.png"], picture=picture, **tags)
    result = imported(tmp_path, expected="exif")
    assert "come from the pictures" in " ".join(result.notes)
    for view, pose in zip(result.views, poses, strict=True):
        off = np.degrees(rotation_angle(view.pose.rotation.T @ pose.rotation))
        assert off < (3.0 if headings == (None, None, None) else 1.0), (view.name, off)


def test_the_compass_stands_in_for_gpano(tmp_path):
    tags = gps(*ORIGIN) | {"GPS:ImgDirection": 45.0, "GPS:ImgDirectionRef": "M"}
    write_images(tmp_path, ["a.jpg"], **tags)
    result = imported(tmp_path, expected="exif")
    ahead = result.views[0].pose.rotation @ [0, 0, -1]
    np.testing.assert_allclose(ahead, [math.sqrt(0.5), 0, -math.sqrt(0.5)], atol=1e-6)
    notes = " ".join(result.notes)
    assert "magnetic" in notes
    assert "GPSImgDirection" in notes


def test_tables_mean_what_the_same_places_mean_in_a_pose_file(tmp_path):
    """Within what a pose file neglects: how meridians and horizons turn over these 1.9 km, 0.015° and 0.017°."""
    keys = ("latitude", "longitude", "altitude", "heading")
    entries = {f"{index}.jpg": dict(zip(keys, place, strict=True)) for index, place in enumerate(PLACES)}
    poses = read_poses(write_json(tmp_path / "poses.json", {"version": 1, "panoramas": entries}))
    for view in imported(write_json(tmp_path / "table.json", entries), expected="table").views:
        assert view.pose.almost_equals(poses.of(view.name).pose, metres=1e-9, radians=math.radians(0.023))


def test_altitudes_are_for_all_or_none(tmp_path):
    without = imported(write_text(tmp_path / "a.csv", "image,lat,lng,heading", "a,1,2,3", "b,1,2,3"), expected="table")
    assert any("equally high" in note for note in without.notes)
    mixed = write_text(tmp_path / "b.csv", "image,lat,lng,heading,alt", "a,1,2,3,5", "b,1,2,3,")
    refuse("altitudes for all panoramas or none, got none for 'b'", mixed)


def test_radians_are_suspected(tmp_path):
    table = write_text(tmp_path / "a.csv", "image,lat,lng,heading", "a,1,2,3.1", "b,1,2,-1.5")
    assert any("are they radians" in note for note in imported(table, expected="table").notes)


def test_images_of_one_name_in_two_folders_are_two_images(tmp_path):
    """Cameras start counting anew in every folder; a file that is in a folder that is given too counts once."""
    names = ["g/a/R1.JPG", "g/b/R1.JPG", "g/b/R2.JPG"]
    for index, name in enumerate(names):
        write_images(tmp_path, [name], **gps(48.0 + index / 1000, 11.5, 500.0), **pano_pose(10.0 * index))
    a, b = tmp_path / "g" / "a", tmp_path / "g" / "b"
    result = imported(a / "R1.JPG", b, b / ".." / "b" / "R1.JPG", expected="exif")
    assert [view.name for view in result.views] == ["a/R1.JPG", "b/R1.JPG", "b/R2.JPG"]
    assert [view.image for view in result.views] == [tmp_path / name for name in names]
    north = [-view.pose.position[2] for view in result.views]
    np.testing.assert_allclose(np.diff(north), 111.2, atol=0.1)
    assert [view.name for view in imported(b, b / "R1.JPG", expected="exif").views] == ["R1.JPG", "R2.JPG"]
    (alone,) = imported(a, expected="exif").views
    assert alone.name == "R1.JPG"
