"""A point of the foreign world falls on the same pixel by the foreign formula and by ours, for every format."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from foreign_samples import (
    PIXELS,
    SIZE,
    axis_angle,
    camera_to_world,
    check_views,
    imported,
    opencv_pixel,
    our_pixel,
    refuse,
    row,
    samples,
    world_to_camera,
    write_images,
    write_json,
    write_text,
    y_down,
    z_up,
)

from omnisyn_cli.errors import PoseError
from omnisyn_cli.poses.formats.files import CAMERA_AXES, WORLD_UP

COUNT = 6
NAMES = [f"{index:02d}.png" for index in range(COUNT)]


def test_colmap(tmp_path):
    lines = []
    for index, (turn, translation, _) in enumerate(samples(COUNT), start=1):
        lines += [
            f"{index} {row(axis_angle(turn)[1], translation)} 1 pano {NAMES[index - 1]}",
            "1.5 2.5 -1" if index % 2 else "",
        ]
    write_text(tmp_path / "sparse" / "0" / "images.txt", "# comment", *lines)
    write_text(tmp_path / "sparse" / "0" / "cameras.txt", "# comment", "1 EQUIRECTANGULAR 1024 512 1024 512")
    result = imported(tmp_path, expected="colmap")
    assert [view.name for view in result.views] == [f"pano {name}" for name in NAMES]
    assert not result.is_metric
    check_views(result, world_to_camera(COUNT))


def test_pycolmap_sees_points_of_panoramas_where_we_do(tmp_path):
    """COLMAP's own projection, and its binary of the same model."""
    pycolmap = pytest.importorskip("pycolmap", minversion="4.2")
    poses = [(axis_angle(turn)[1], translation) for turn, translation, _ in samples(COUNT)]
    lines = [f"{index + 1} {row(q, t)} 1 {NAMES[index]}\n" for index, (q, t) in enumerate(poses)]
    write_text(tmp_path / "text" / "images.txt", *lines)
    write_text(tmp_path / "text" / "cameras.txt", "1 EQUIRECTANGULAR 1024 512 1024 512")
    write_text(tmp_path / "text" / "points3D.txt", "")
    model = pycolmap.Reconstruction(tmp_path / "text")
    (tmp_path / "binary").mkdir()
    model.write_binary(tmp_path / "binary")
    for kind in ("text", "binary"):
        views = {view.name: view for view in imported(tmp_path / kind, expected="colmap").views}
        for image, (_, _, point) in zip(model.images.values(), samples(COUNT), strict=True):
            col, at = image.project_point(point) - 0.5
            np.testing.assert_allclose(our_pixel(views[image.name].pose, y_down(point)), (at, col), atol=PIXELS)


def matrix_text(turn: np.ndarray, place: np.ndarray) -> str:
    return row(np.c_[turn, place], [0, 0, 0, 1])


def metashape_text(chunk_poses: list[str], transform: str, reference: str, sensor: str = "spherical") -> str:
    cameras = "".join(
        f'<camera id="{index}" sensor_id="0" component_id="0" label="{name}"><transform>{matrix}</transform></camera>'
        for index, (name, matrix) in enumerate(zip(NAMES, chunk_poses, strict=False))
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><document version="2.0.0"><chunk><sensors>'
        f'<sensor id="0" type="{sensor}"/><sensor id="1" type="frame"/></sensors><components>'
        f'<component id="0">{transform}</component></components><cameras>{cameras}'
        f'<group><camera id="8" sensor_id="1" label="flat.jpg"/></group><camera id="9" sensor_id="0" label="loose"/>'
        f"</cameras><reference>{reference}</reference></chunk></document>"
    )


def similarity(turn: np.ndarray, place: np.ndarray, scale: float) -> str:
    parts = {"rotation": row(turn), "translation": row(place), "scale": repr(scale)}
    inside = "".join(f'<{name} locked="false">{text}</{name}>' for name, text in parts.items())
    return f"<transform>{inside}</transform>"


@pytest.mark.parametrize("reference", ['LOCAL_CS["Local Coordinates (m)"]', 'GEOGCS["WGS 84"]', ""])
def test_metashape(tmp_path, reference):
    """The manual's spherical camera in a chunk that a similarity takes to z up, to the earth, or that has none."""
    turn, scale = axis_angle((0.3, -0.2, 1.1))[0], 2.5
    place, to_local = np.array([1.0, 2.0, 3.0]), np.eye(3)
    if reference.startswith("GEOGCS"):  # above 90° east on the equator, where north is +z and east is −x
        place, to_local = np.array([0.0, 6378137.0 + 100.0, 0.0]), np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    transform = similarity(turn, place, scale) if reference else ""
    text = metashape_text([matrix_text(*pose) for pose in camera_to_world(COUNT)], transform, reference)
    origin = {"origin": (0.0, 90.0, 100.0)} if reference.startswith("GEOGCS") else {}
    result = imported(write_text(tmp_path / "cameras.xml", text), expected="metashape", **origin)
    assert [view.name for view in result.views] == NAMES
    for view, (rotation, shift), (_, _, point) in zip(
        result.views, world_to_camera(COUNT), samples(COUNT), strict=True
    ):
        seen = opencv_pixel(rotation @ point + shift)
        if reference:
            world = to_local @ (scale * turn @ point + place - (place if origin else 0))
            np.testing.assert_allclose(our_pixel(view.pose, z_up(world)), seen, atol=1e3 * PIXELS)
    notes = " ".join(result.notes)
    assert "left out: 'flat.jpg', 'loose'" in notes
    assert ("has no scale" in notes) == (not reference)
    if not reference:
        ups = np.mean([view.pose.rotation[:, 1] for view in result.views], axis=0)
        np.testing.assert_allclose(ups / np.linalg.norm(ups), [0, 1, 0], atol=1e-9)


def test_what_metashape_wrote_of_other_cameras_is_refused(tmp_path):
    for text, message in {
        metashape_text(["1 2 3"], "", ""): r"camera '00.png': expected 16 numbers",
        metashape_text([], "", "", "frame"): "aligned cameras of a spherical sensor, got sensors 'frame', 'frame'",
        metashape_text([], "", ""): "got 1 that are not aligned",
        metashape_text([matrix_text(np.eye(3), np.zeros(3))], similarity(np.eye(3), np.zeros(3), 0.0), ""): "above 0",
        "<html/>": "XML without a chunk",
        "<chunk": "expected XML, got 'unclosed token",
        '<!DOCTYPE a [<!ENTITY b "c">]><chunk/>': "a declaration of entities",
    }.items():
        refuse(message, write_text(tmp_path / "a.xml", text))


@pytest.mark.parametrize("header", ["# pano poses v1.0: ID; filename; timestamp; {}", "id;image;time;{}"])
def test_quaternions_in_metres(tmp_path, header):
    """NavVis: x forward, y left, z up, in a world with z up."""
    axes = [f"pano_pos_{axis}" for axis in "xyz"] + [f"pano_ori_{part}" for part in "wxyz"]
    lines = [
        f"{index}; {NAMES[index]}; 1e9; {row(place, axis_angle(turn)[1]).replace(' ', '; ')}"
        for index, (turn, place, _) in enumerate(samples(COUNT))
    ]
    source = write_text(tmp_path / "pano-poses.csv", header.format("; ".join(axes)), *lines)
    write_images(tmp_path, NAMES[:1])
    result = imported(source, expected="xyz")
    assert result.views[0].image == tmp_path / NAMES[0]
    for view, (turn, place, point) in zip(result.views, samples(COUNT), strict=True):
        ahead, left, up = axis_angle(turn)[0].T @ (point - place)
        np.testing.assert_allclose(our_pixel(view.pose, z_up(point)), opencv_pixel((-left, -up, ahead)), atol=PIXELS)
    assert any("--camera-axes says otherwise" in note for note in result.notes)


def test_headings_in_metres(tmp_path):
    """Coordinates of a country; the camera looks east, a point north-east of it and as high is 45° to the left."""
    rows = [{"name": name, "X": 691000 + 5 * k, "Y": 5334000, "Z": 520, "heading": 90} for k, name in enumerate("ab")]
    result = imported(write_json(tmp_path / "a.json", rows), expected="xyz")
    np.testing.assert_allclose(result.views[1].pose.position, [5, 0, 0], atol=1e-9)
    height, width = SIZE
    seen = our_pixel(result.views[1].pose, z_up(np.array([5.0 + 3.0, 3.0, 0.0])))
    np.testing.assert_allclose(seen, (height / 2 - 0.5, (0.5 - 45 / 360) * width - 0.5), atol=PIXELS)
    assert any("counted from the first panorama" in note for note in result.notes)
    for text, message in {
        "image,x,y,z\na,1,2,3": r"a\.csv:2: expected a quaternion \(qw, qx, qy, qz\) or a heading",
        "image,x,y,z,heading\na,1,,3,5": r"a\.csv:2: expected numbers \(y\)",
        "image,x,y,z,qw,qx,qy,qz\na,1,2,3,1,1,0,0": "unit quaternion",
    }.items():
        refuse(message, write_text(tmp_path / "a.csv", text))


def faces_of_panorama_sfm(pitches: tuple[float, ...]) -> list[np.ndarray]:
    """Camera-from-panorama rotations as COLMAP's ``panorama_sfm.py`` cuts faces: Rx(−pitch) · Ry(−yaw)."""
    turns = []
    for pitch in pitches:
        for step in range(4):
            yaw = 90.0 * step + (45.0 if pitch > 0 else 0.0)
            about_y = axis_angle((0, -math.radians(yaw), 0))[0] if yaw else np.eye(3)
            turns.append((axis_angle((-math.radians(pitch), 0, 0))[0] if pitch else np.eye(3)) @ about_y)
    return turns


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """``[w, x, y, z]`` of a rotation matrix by its eigenvector of 1 and its trace."""
    w = math.sqrt(max(1 + np.trace(rotation), 1e-12)) / 2
    skew = np.array([rotation[2, 1], rotation[0, 2], rotation[1, 0]]) - [rotation[1, 2], rotation[2, 0], rotation[0, 1]]
    if w > 1e-3:
        return np.array([w, *(skew / (4 * w))])
    axis = np.linalg.eigh(rotation + rotation.T)[1][:, -1]
    return np.array([w, *axis]) / np.linalg.norm([w, *axis])


def write_rig_model(folder: Path, pitches: tuple[float, ...], *, is_binary: bool) -> None:
    """A model of one rig with a frame for each of :func:`samples`, as COLMAP 3.12 and later write it."""
    faces = faces_of_panorama_sfm(pitches)
    count = len(faces)
    cameras, sensors = range(1, count + 1), [quaternion(face @ faces[0].T) for face in faces]
    images, frames = [], []
    for index, (turn, translation, _) in enumerate(samples(COUNT)):
        world = axis_angle(turn)[0]
        frames.append((index + 1, quaternion(faces[0] @ world), faces[0] @ translation))
        images += [
            (index * count + k, quaternion(face @ world), face @ translation, k, f"pano_camera{k - 1}/{NAMES[index]}")
            for k, face in zip(cameras, faces, strict=True)
        ]
    data = {frame: [(k, (frame - 1) * count + k) for k in cameras] for frame, _, _ in frames}
    if not is_binary:
        write_text(folder / "cameras.txt", *(f"{k} SIMPLE_PINHOLE 64 64 32 32 32" for k in cameras))
        write_text(folder / "images.txt", *(f"{i} {row(q, t)} {k} {name}\n" for i, q, t, k, name in images))
        others = " ".join(f"CAMERA {k} 1 {row(sensors[k - 1], (0, 0, 0))}" for k in cameras[1:])
        write_text(folder / "rigs.txt", f"1 {count} CAMERA 1 {others}")
        lines = [f"{f} 1 {row(q, t)} {count} " + " ".join(f"CAMERA {k} {i}" for k, i in data[f]) for f, q, t in frames]
        write_text(folder / "frames.txt", *lines)
        return
    folder.mkdir(parents=True)
    camera_bytes = b"".join(struct.pack("<IiQQ3d", k, 0, 64, 64, 32, 32, 32) for k in cameras)
    image_bytes = b"".join(
        struct.pack("<I7dI", i, *q, *t, k) + name.encode() + struct.pack("<xQ2dq", 1, 5.5, 6.5, -1)
        for i, q, t, k, name in images
    )
    rig_bytes = struct.pack("<IIiI", 1, count, 0, 1) + b"".join(
        struct.pack("<iIB7d", 0, k, 1, *sensors[k - 1], 0, 0, 0) for k in cameras[1:]
    )
    frame_bytes = b"".join(
        struct.pack("<II7dI", f, 1, *q, *t, count) + b"".join(struct.pack("<iIQ", 0, k, i) for k, i in data[f])
        for f, q, t in frames
    )
    for name, number, content in (
        ("cameras", count, camera_bytes), ("images", len(images), image_bytes), ("rigs", 1, rig_bytes),
        ("frames", COUNT, frame_bytes),
    ):  # fmt: skip
        (folder / f"{name}.bin").write_bytes(struct.pack("<Q", number) + content)


@pytest.mark.parametrize("is_binary", [False, True])
@pytest.mark.parametrize("pitches", [(-35.0, 0.0, 35.0), (0.0,)], ids=["overlapping", "four faces"])
def test_colmap_rigs_of_virtual_cameras_are_the_panoramas_that_they_were_cut_from(tmp_path, pitches, is_binary):
    write_rig_model(tmp_path / "sparse" / "0", pitches, is_binary=is_binary)
    write_images(tmp_path / "images", NAMES[:1])
    result = imported(tmp_path, expected="colmap")
    assert [view.name for view in result.views] == NAMES
    assert result.views[0].image == tmp_path / "images" / NAMES[0]
    assert any("put together from the faces of a rig" in note for note in result.notes)
    check_views(result, world_to_camera(COUNT))


def test_pycolmap_writes_rigs_as_they_are_read(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    write_rig_model(tmp_path / "text", (-35.0, 0.0, 35.0), is_binary=False)
    write_text(tmp_path / "text" / "points3D.txt", "")
    (tmp_path / "binary").mkdir()
    pycolmap.Reconstruction(tmp_path / "text").write_binary(tmp_path / "binary")
    text, binary = (imported(tmp_path / kind, expected="colmap") for kind in ("text", "binary"))
    assert {view.name for view in binary.views} == set(NAMES)
    poses = {view.name: view.pose for view in binary.views}
    assert all(view.pose.almost_equals(poses[view.name]) for view in text.views)


@pytest.mark.parametrize("is_binary", [False, True])
def test_spheresfm(tmp_path, is_binary):
    """Its SPHERE sees what EQUIRECTANGULAR sees; in binary it has the number of one of COLMAP's fisheyes."""
    poses = [(axis_angle(turn)[1], translation) for turn, translation, _ in samples(COUNT)]
    if is_binary:
        (tmp_path / "cameras.bin").write_bytes(struct.pack("<QIiQQ3d", 1, 1, 11, 1024, 512, 1, 512, 256))
        images = (
            struct.pack("<I7dI", i, *q, *t, 1) + NAMES[i].encode() + struct.pack("<xQ", 0)
            for i, (q, t) in enumerate(poses)
        )
        (tmp_path / "images.bin").write_bytes(struct.pack("<Q", COUNT) + b"".join(images))
    else:
        write_text(tmp_path / "cameras.txt", "1 SPHERE 1024 512 1 512 256")
        write_text(tmp_path / "images.txt", *(f"{i} {row(q, t)} 1 {NAMES[i]}\n" for i, (q, t) in enumerate(poses)))
    result = imported(tmp_path, expected="colmap")
    check_views(result, world_to_camera(COUNT))


@pytest.mark.parametrize("projection", ["spherical", "equirectangular"])
def test_opensfm(tmp_path, projection):
    """``x = lon / 2π · w + (w − 1) / 2`` and ``y = −lat / 2π · w + (h − 1) / 2`` in indices of pixels."""
    shots = {
        name: {"camera": "c", "rotation": list(turn), "translation": list(translation)}
        for name, (turn, translation, _) in zip(NAMES, samples(COUNT), strict=True)
    }
    document = [{"cameras": {"c": {"projection_type": projection}}, "shots": shots, "points": {}}]
    result = imported(write_json(tmp_path / "reconstruction.json", document), expected="opensfm")
    height, width = SIZE
    for view, (turn, translation, point) in zip(result.views, samples(COUNT), strict=True):
        x, y, z = axis_angle(turn)[0] @ point + translation
        longitude, latitude = math.atan2(x, z), math.atan2(-y, math.hypot(x, z))
        foreign = (
            -latitude / (2 * math.pi) * width + (height - 1) / 2,
            longitude / (2 * math.pi) * width + (width - 1) / 2,
        )
        np.testing.assert_allclose(our_pixel(view.pose, z_up(point)), foreign, atol=PIXELS)


def test_nerfstudio(tmp_path):
    """The ray that nerfstudio shoots through a pixel meets a point that falls on that pixel."""
    frames = [
        {
            "file_path": f"./images/{name}",
            "transform_matrix": [*np.c_[axis_angle(turn)[0], place].tolist(), [0, 0, 0, 1]],
        }
        for name, (turn, place, _) in zip(NAMES, samples(COUNT), strict=True)
    ]
    document = {"camera_model": "EQUIRECTANGULAR", "frames": frames, "applied_transform": np.eye(4)[:3].tolist()}
    write_json(tmp_path / "transforms.json", document)
    result = imported(tmp_path, expected="nerfstudio")
    height, width = SIZE
    for index, (view, (turn, place, _)) in enumerate(zip(result.views, samples(COUNT), strict=True)):
        at_row, at_col = 20.0 + 77.3 * index, 1000.0 - 181.7 * index
        x, y = (at_col + 0.5 - width / 2) / (width / 2), -(at_row + 0.5 - height / 2) / height
        theta, phi = -math.pi * x, math.pi * (0.5 - y)
        direction = (-math.sin(theta) * math.sin(phi), math.cos(phi), -math.cos(theta) * math.sin(phi))
        point = place + 7.0 * axis_angle(turn)[0] @ direction
        np.testing.assert_allclose(our_pixel(view.pose, z_up(point)), (at_row, at_col), atol=PIXELS)


def test_nerfstudio_scales_are_undone(tmp_path):
    """``applied = s · original``: distances come back to those of the original, pixels stay."""
    turn, place, point = samples(1)[0]
    frame = {"file_path": "a.png", "transform_matrix": np.c_[axis_angle(turn)[0], place * 6].tolist()}
    applied = np.c_[2 * axis_angle((0.1, 0.2, 0.3))[0], [1, 2, 3]].tolist()
    document = {"frames": [frame], "applied_scale": 3.0, "applied_transform": applied}
    result = imported(write_json(tmp_path / "transforms.json", document), expected="nerfstudio")
    pose = result.views[0].pose
    np.testing.assert_allclose(pose.position, z_up(place), atol=1e-12)
    assert any("divided by the applied scale 6" in note for note in result.notes)
    assert any("no camera_model" in note for note in result.notes)
    local = axis_angle(turn)[0].T @ (point - place)
    np.testing.assert_allclose(pose.inverse().transform(z_up(point)), local, atol=1e-12)


def test_tum(tmp_path):
    """Camera-to-world, quaternion with w last."""
    lines = []
    for index, (turn, place, _) in enumerate(samples(COUNT)):
        w, x, y, z = axis_angle(turn)[1]
        lines.append(f"{1000.25 + index} {row(place, (x, y, z, w))}")
    write_text(tmp_path / "poses.tum", "# timestamp tx ty tz qx qy qz qw", *lines)
    write_images(tmp_path / "images", NAMES)
    result = imported(tmp_path / "poses.tum", expected="tum")
    check_views(result, camera_to_world(COUNT))


def test_kitti(tmp_path):
    lines = [row(np.c_[axis_angle(turn)[0], place]) for turn, place, _ in samples(COUNT)]
    write_images(tmp_path, NAMES)
    result = imported(write_text(tmp_path / "00.txt", *lines), expected="kitti")
    assert [view.name for view in result.views] == NAMES
    check_views(result, camera_to_world(COUNT))


def test_habitat(tmp_path):
    """PanSplat turns these files into OpenCV cameras in a world with z up by two matrices; both sides must agree."""
    world = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera = np.diag([1, -1, -1])
    for index, (turn, place, _) in enumerate(samples(COUNT)):
        folder = tmp_path / str(index)
        write_images(folder, ["rgb.png", "depth.png"])
        np.savetxt(folder / "rot.txt", axis_angle(turn)[0], fmt="%.17g")
        np.savetxt(folder / "tran.txt", place, fmt="%.17g")
    result = imported(tmp_path, expected="habitat")
    for index, (view, (turn, place, point)) in enumerate(zip(result.views, samples(COUNT), strict=True)):
        rotation, position = world @ axis_angle(turn)[0] @ camera, world @ place
        foreign = opencv_pixel(rotation.T @ (world @ point - position))
        np.testing.assert_allclose(our_pixel(view.pose, point), foreign, atol=PIXELS)
        assert view.image == tmp_path / str(index) / "rgb.png"
        assert view.depth == tmp_path / str(index) / "depth.png"


def test_zind(tmp_path):
    """A corner of the room falls where ZInD's own code draws it: ``θ = atan2(−x, y)``, ``φ = asin(z / ρ)``."""
    rng = np.random.default_rng(0)
    metres = 3.5
    plans = [(rng.normal(size=2), rng.uniform(-180, 180), rng.uniform(0.5, 2)) for _ in range(COUNT)]
    panos = {
        f"pano_{index}": {
            "image_path": f"panos/{NAMES[index]}",
            "camera_height": 1.0,
            "floor_plan_transformation": {"translation": list(place), "rotation": degrees, "scale": scale},
        }
        for index, (place, degrees, scale) in enumerate(plans)
    }
    document = {
        "merger": {"floor_01": {"complete_room_01": {"partial_room_01": panos}}},
        "scale_meters_per_coordinate": {"floor_01": metres},
    }
    result = imported(write_json(tmp_path / "zind_data.json", document), expected="zind")
    height, width = SIZE
    for view, (place, degrees, scale) in zip(result.views, plans, strict=True):
        x, y, z = local = rng.normal(size=3) * 3
        turned = np.array([[math.cos(math.radians(degrees)), math.sin(math.radians(degrees))],
                           [-math.sin(math.radians(degrees)), math.cos(math.radians(degrees))]])  # fmt: skip
        on_floor = local[:2].dot(turned) * scale + place
        height_above_floor = (z + 1.0) * scale
        point = metres * np.array([-on_floor[0], height_above_floor, -on_floor[1]])
        theta, phi = math.atan2(-x, y), math.asin(z / np.linalg.norm(local))
        angles = ((0.5 - phi / math.pi) * height - 0.5, (0.5 + theta / (2 * math.pi)) * width - 0.5)
        drawn = ((0.5 - phi / math.pi) * (height - 1), (0.5 + theta / (2 * math.pi)) * (width - 1))
        np.testing.assert_allclose(our_pixel(view.pose, point), angles, atol=PIXELS)
        np.testing.assert_allclose(our_pixel(view.pose, point), drawn, atol=0.5)  # its code has another pixel centre


def test_authors(tmp_path):
    """Arrays made as their CARLA reader makes them see a point where CARLA's own (left-handed) axes put it."""
    rng = np.random.default_rng(0)
    places, yaws = rng.normal(size=(COUNT, 3)) * 4, rng.uniform(-3, 3, COUNT)
    reference = COUNT - 1

    def about_up(angle: float) -> np.ndarray:
        return axis_angle((0, angle, 0))[0]

    def seen(point: np.ndarray, index: int) -> np.ndarray:
        """Right, up and backwards of a point of CARLA's world (x forward, y right, z up, yaw clockwise)."""
        x, y, z = point - places[index]
        cosine, sine = math.cos(yaws[index]), math.sin(yaws[index])
        return np.array([cosine * y - sine * x, z, -(cosine * x + sine * y)])

    retract = places[:, [1, 2, 0]] * (1, 1, -1)
    turns = [about_up(-yaw) for yaw in yaws]
    rotations = np.stack([turns[reference] @ turn.T for turn in turns])
    translations = np.stack([-(turns[reference].T @ (place - retract[reference])) for place in retract])
    np.save(tmp_path / "rotations.npy", rotations[None])
    np.save(tmp_path / "translations.npy", translations[None])
    write_images(tmp_path, ["0.png", "5.png"])
    result = imported(tmp_path, expected="authors")
    assert [view.name for view in result.views] == ["0.png", "5.png"]
    for view, index in zip(result.views, (0, 5), strict=True):
        for point in rng.normal(size=(5, 3)) * 10:
            right, up, back = seen(point, index)
            foreign = opencv_pixel(np.array([right, -up, -back]))
            np.testing.assert_allclose(our_pixel(view.pose, seen(point, reference)), foreign, atol=PIXELS)


UPWARD = {"y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}
LOOKING = {"opengl": ((0, 0, -1), (0, 1, 0)), "opencv": ((0, 0, 1), (0, -1, 0)), "flu": ((1, 0, 0), (0, 0, 1))}


def test_axes_are_what_their_names_say():
    """Rotations, x stays x in a world; a camera's forward and upward axes come from ours."""
    assert set(WORLD_UP) == set(UPWARD)
    assert set(CAMERA_AXES) == set(LOOKING)
    for name, matrix in WORLD_UP.items():
        np.testing.assert_array_equal(matrix @ UPWARD[name], [0, 1, 0])
        np.testing.assert_array_equal(matrix @ [1, 0, 0], [1, 0, 0])
        assert np.linalg.det(matrix) == pytest.approx(1)
    for name, matrix in CAMERA_AXES.items():
        forward, upward = LOOKING[name]
        np.testing.assert_array_equal(matrix @ [0, 0, -1], forward)
        np.testing.assert_array_equal(matrix @ [0, 1, 0], upward)
        assert np.linalg.det(matrix) == pytest.approx(1)


def test_opensfm_moves_to_another_origin(tmp_path):
    """A shot at the reference is where a table puts that place; without a reference there is nothing to move from."""
    reference = {"latitude": 48.2, "longitude": 11.4, "altitude": 505.0}
    shots = {"a.png": {"camera": "c", "rotation": [0, 0, 0], "translation": [0, 0, 0]}}
    document = {"cameras": {"c": {"projection_type": "spherical"}}, "shots": shots, "reference_lla": reference}
    origin = (48.1, 11.5, 520.0)
    source = write_json(tmp_path / "reconstruction.json", [document])
    pose = imported(source, expected="opensfm", origin=origin).views[0].pose
    table = write_text(tmp_path / "a.csv", "image,lat,lng,alt,heading", "a.png,48.2,11.4,505,0")
    level = imported(table, expected="table", origin=origin).views[0].pose
    np.testing.assert_allclose(pose.position, level.position, atol=1e-6)
    up = np.array([0, 1, 0])  # OpenSfM's cameras look along z; without a rotation that is its world's up
    np.testing.assert_allclose(level.rotation.T @ pose.rotation @ [0, 0, -1], up, atol=1e-9)
    write_json(tmp_path / "reconstruction.json", [{**document, "reference_lla": {}}])
    with pytest.raises(PoseError, match="expected a reference_lla"):
        imported(source, expected="opensfm", origin=origin)
