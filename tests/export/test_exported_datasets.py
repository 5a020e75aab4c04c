"""Data sets, points and discs as their programs read them: on the wall, in its colours, through the stated camera."""

import json
from dataclasses import replace
from pathlib import Path

import gsply
import numpy as np
import pytest
import trimesh
from export_samples import CHAIN, OPENCV, exported, job_in, off_wall, wall_colour
from PIL import Image

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, rotation_from_quaternion
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions, pixel_scale
from omnisyn_cli.interpolation.export.datasets import DISC_RADIUS_SHARE, FACES, points_of
from omnisyn_cli.interpolation.export.formats import plan_export
from omnisyn_cli.interpolation.export.run import run_export
from omnisyn_cli.io import read_depth, write_depth
from omnisyn_cli.render.mesh import Cut, build_mesh
from synthesis_samples import RADIUS, SIZE, hall_image, open_to_the_sky, posed, write_mask

HALF_PIXEL = 0.02  # Metres: nearest depth on faces is up to half a pixel aside.
Z_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # Ours from a world with z up: its y is our −z.


def lines_of(path: Path) -> list[list[str]]:
    """Fields of the lines that are no comments and not empty, as COLMAP's documentation defines its text files."""
    texts = path.read_text(encoding="utf-8").splitlines()
    return [line.split() for line in texts if line.strip() and not line.startswith("#")]


def pixel_grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of pixel centres, half a pixel from the corner, as COLMAP and nerfstudio have them."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return x, y


def read_map(path: Path) -> np.ndarray:
    """A dense map of COLMAP, by its definition: width&height&channels& and float32, row after row."""
    width, height, channels, data = path.read_bytes().split(b"&", 3)
    assert int(channels) == 1
    return np.frombuffer(data, "<f4").reshape(int(height), int(width))


def test_colmaps_text_puts_the_pixels_of_six_faces_on_the_wall(tmp_path: Path) -> None:
    exported(tmp_path, "out", format="colmap")
    model = tmp_path / "out" / "faces" / "sparse" / "0"
    cameras = {fields[0]: fields for fields in lines_of(model / "cameras.txt")}
    images = lines_of(model / "images.txt")
    assert len(images) == len(FACES) * len(CHAIN)
    for _, *numbers, camera, name in images:
        _, kind, width, height, *parameters = cameras[camera]
        fx, fy, cx, cy = map(float, parameters)
        assert kind == "PINHOLE"
        x, y = pixel_grid(int(height), int(width))
        depth = read_map(tmp_path / "out" / "faces" / "stereo" / "depth_maps" / f"{name}.geometric.bin")
        local = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], -1) * depth[..., None]
        rotation, shift = rotation_from_quaternion(np.array(numbers[:4], float)), np.array(numbers[4:], float)
        world = (local - shift) @ rotation
        assert off_wall(world).max() < HALF_PIXEL * 4
        picture = np.asarray(Image.open(tmp_path / "out" / "faces" / "images" / name), float) / 255
        direction = local @ rotation / np.linalg.norm(local, axis=-1, keepdims=True)
        pose = CHAIN[int(name.split("/")[1][:4])]
        seen = sample_bilinear(hall_image(pose), direction @ OPENCV @ pose.rotation)
        assert np.abs(picture - seen).mean() < 0.01
        mask = np.asarray(Image.open(tmp_path / "out" / "faces" / "masks" / f"{name}.png"))
        assert mask.min() == 255


def test_faces_go_on_where_the_front_ends(tmp_path: Path) -> None:
    """Right and left of it, above and below; the back where the right one ends."""
    exported(tmp_path, "out", format="colmap", chain=CHAIN[:2])
    faces = {
        face: np.asarray(Image.open(tmp_path / "out" / "faces" / "images" / face / "0001_p1.jpg"), float)
        for face in FACES
    }
    front = faces["front"]
    for edge, other in (
        (front[:, -1], faces["right"][:, 0]), (front[:, 0], faces["left"][:, -1]),
        (front[0], faces["up"][-1]), (front[-1], faces["down"][0]), (faces["right"][:, -1], faces["back"][:, 0]),
    ):  # fmt: skip
        assert np.abs(edge - other).mean() < 0.3 * np.abs(edge - other[::-1]).mean()


def test_colmaps_text_puts_the_pixels_of_panoramas_on_the_wall(tmp_path: Path) -> None:
    exported(tmp_path, "out", format="colmap")
    folder = tmp_path / "out" / "panoramas"
    cameras = {fields[0]: fields for fields in lines_of(folder / "sparse" / "0" / "cameras.txt")}
    x, y = pixel_grid(*SIZE)
    for _, *numbers, camera, name in lines_of(folder / "sparse" / "0" / "images.txt"):
        assert cameras[camera][1:] == ["EQUIRECTANGULAR", "128", "64", "128", "64"]
        longitude, latitude = (x / SIZE[1] - 0.5) * 2 * np.pi, (0.5 - y / SIZE[0]) * np.pi
        ray = np.stack(
            [np.cos(latitude) * np.sin(longitude), -np.sin(latitude), np.cos(latitude) * np.cos(longitude)], -1
        )
        depth = read_depth(folder / "depth" / name.replace(".jpg", ".exr"))
        rotation, shift = rotation_from_quaternion(np.array(numbers[:4], float)), np.array(numbers[4:], float)
        assert off_wall((ray * depth[..., None] - shift) @ rotation).max() < 1e-3
        assert (folder / "images" / name).is_file()
    points = np.array(lines_of(folder / "sparse" / "0" / "points3D.txt"), float)
    assert off_wall(points[:, 1:4]).max() < 1e-3
    assert np.abs(points[:, 4:7] - wall_colour(points[:, 1:4] @ OPENCV)).mean() < 10
    assert np.array_equal(points[:, 0], np.arange(1, len(points) + 1))


def test_pycolmap_reads_both_models_as_they_are_meant(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    exported(tmp_path, "out", format="colmap")
    rig = pycolmap.Reconstruction(tmp_path / "out" / "faces" / "sparse" / "0")
    assert (rig.num_rigs(), rig.num_frames(), rig.num_images(), rig.num_cameras()) == (1, 3, 18, 6)
    whole = pycolmap.Reconstruction(tmp_path / "out" / "panoramas" / "sparse" / "0")
    assert whole.num_images() == 3
    assert whole.num_points3D() == rig.num_points3D() > 100
    for model in (rig, whole):
        for image in model.images.values():
            pose = CHAIN[int(Path(image.name).name[:4])]
            np.testing.assert_allclose(image.projection_center() @ OPENCV, pose.position, atol=1e-9)
    configured = json.loads((tmp_path / "out" / "faces" / "rig_config.json").read_text())[0]["cameras"]
    for frame in rig.frames.values():
        for data in frame.data_ids:
            image = rig.image(data.id)
            camera = configured[image.camera_id - 1]
            assert image.name.startswith(camera["image_prefix"])
            if "ref_sensor" not in camera:
                turn = rotation_from_quaternion(np.array(camera["cam_from_rig_rotation"]))
                expected = turn @ frame.rig_from_world.rotation.matrix()
                np.testing.assert_allclose(image.cam_from_world().rotation.matrix(), expected, atol=1e-9)
    camera, image = whole.camera(1), whole.image(1)
    for point in list(whole.points3D.values())[:50]:
        local = image.cam_from_world() * point.xyz
        x, y = camera.img_from_cam(local[None])[0]
        longitude, latitude = np.arctan2(local[0], local[2]), np.arcsin(-local[1] / np.linalg.norm(local))
        assert x == pytest.approx((longitude / (2 * np.pi) + 0.5) * SIZE[1], abs=1e-6)
        assert y == pytest.approx((0.5 - latitude / np.pi) * SIZE[0], abs=1e-6)


def test_nerfstudios_rays_end_on_the_wall(tmp_path: Path) -> None:
    """The rays of ``nerfstudio/cameras/cameras.py``: unit vectors, so its depth along the ray is Euclidean."""
    exported(tmp_path, "out", format="nerfstudio")
    folder = tmp_path / "out"
    document = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
    assert document["camera_model"] == "EQUIRECTANGULAR"
    assert len(document["frames"]) == len(CHAIN)
    for pose, frame in zip(CHAIN, document["frames"], strict=True):
        x, y = pixel_grid(frame["h"], frame["w"])
        across, upward = (x - frame["cx"]) / frame["fl_x"], -(y - frame["cy"]) / frame["fl_y"]
        theta, phi = -np.pi * across, np.pi * (0.5 - upward)
        ray = np.stack([-np.sin(theta) * np.sin(phi), np.cos(phi), -np.cos(theta) * np.sin(phi)], -1)
        depth = np.asarray(Image.open(folder / frame["depth_file_path"]), float) * document["depth_unit_scale_factor"]
        matrix = np.array(frame["transform_matrix"])
        np.testing.assert_allclose(Z_UP @ matrix[:3, 3], pose.position, atol=1e-9)
        world = (ray * depth[..., None]) @ matrix[:3, :3].T + matrix[:3, 3]
        assert off_wall(world).max() < 6e-4  # half a millimetre is rounded away
        picture = np.asarray(Image.open(folder / frame["file_path"]), float) / 255
        assert np.abs(picture - hall_image(pose)).mean() < 0.01
        assert np.asarray(Image.open(folder / frame["mask_path"])).min() == 255
    cloud = trimesh.load(folder / document["ply_file_path"])
    assert off_wall(cloud.vertices).max() < 1e-4
    # colours are those of a picture of 16 rows
    assert np.abs(cloud.colors[:, :3] - wall_colour(cloud.vertices @ Z_UP.T)).mean() < 10


def test_what_is_unknown_or_too_far_for_millimetres_is_zero(tmp_path: Path) -> None:
    mask = write_mask(tmp_path / "a mask.png", 50)
    job = job_in(tmp_path, "out", format="nerfstudio", chain=CHAIN[:2], masks=(mask, mask))
    depth = np.array(read_depth(tmp_path / "p0_depth.exr"))
    depth[:10], depth[10:20] = np.inf, 70.0
    write_depth(tmp_path / "p0_depth.exr", depth)
    run_export(plan_export(job))
    found = np.asarray(Image.open(tmp_path / "out" / "depths" / "0000_p0.png"))
    assert not found[:20].any()
    assert found[20:50].all()
    assert not found[50:].any()
    masks = (Image.open(path).convert("L") for path in (tmp_path / "out" / "masks" / "0000_p0.png", mask))
    assert np.array_equal(*map(np.asarray, masks))


def files_in(folder: Path) -> set[str]:
    return {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("form", ["colmap", "nerfstudio"])
def test_a_smaller_data_set_in_its_place_leaves_nothing_of_the_former_one(tmp_path: Path, form: str) -> None:
    """But all that others have put there stays, whatever it is called."""
    exported(tmp_path, "out", format=form)
    kind = "panoramas/images" if form == "colmap" else "images"
    strangers = {"mine.txt", f"{kind}/0002_mine.jpg", f"{kind}/0009_p9.jpg"}
    for name in strangers:
        (tmp_path / "out" / name).write_text("mine")
    for output in ("out", "fresh"):
        exported(tmp_path, output, format=form, chain=CHAIN[:2], overwrite=True)
    assert files_in(tmp_path / "out") == files_in(tmp_path / "fresh") | strangers


def test_pictures_of_somebody_elses_data_set_stay(tmp_path: Path) -> None:
    """It names no depth and no masks of them."""
    pictures = tmp_path / "out" / "images"
    pictures.mkdir(parents=True)
    (pictures / "0007_theirs.jpg").write_text("theirs")
    text = json.dumps({"frames": [{"file_path": "images/0007_theirs.jpg"}]})
    (tmp_path / "out" / "transforms.json").write_text(text)
    exported(tmp_path, "out", format="nerfstudio", chain=CHAIN[:2], overwrite=True)
    assert (pictures / "0007_theirs.jpg").is_file()


def test_points_lie_on_the_wall_in_its_colours(tmp_path: Path) -> None:
    """The hall is a ball about the world's origin: a wrong axis, unit, order or origin would leave it."""
    summary = exported(tmp_path, "hall.ply")
    cloud = trimesh.load(tmp_path / "hall.ply")
    assert len(cloud.vertices) == summary.results["points"]
    assert off_wall(cloud.vertices).max() < 1e-4
    np.testing.assert_allclose(cloud.colors[:, :3], wall_colour(cloud.vertices), atol=2)


def test_a_reader_of_ply_finds_all_properties(tmp_path: Path) -> None:
    plyfile = pytest.importorskip("plyfile")
    exported(tmp_path, "hall.ply", stride=4)
    vertices = plyfile.PlyData.read(tmp_path / "hall.ply")["vertex"]
    points, normals = (np.stack([vertices[name] for name in names], -1) for names in ("xyz", ("nx", "ny", "nz")))
    assert off_wall(points).max() < 1e-4
    np.testing.assert_allclose((points * normals).sum(-1), -RADIUS, atol=0.05)
    np.testing.assert_allclose(vertices["confidence"], 1)


def test_points_are_as_dense_at_the_poles_as_at_the_equator(tmp_path: Path) -> None:
    exported(tmp_path, "hall.ply", chain=[CHAIN[0]] * 2)
    seen = trimesh.load(tmp_path / "hall.ply").vertices - CHAIN[0].position
    height = seen[:, 1] / np.linalg.norm(seen, axis=1)
    counts, _ = np.histogram(height, bins=8, range=(-1, 1))  # zones of equal height have equal areas
    assert counts.min() > 0.9 * counts.mean()


def test_a_stride_leaves_out_points_in_both_directions(tmp_path: Path) -> None:
    all_points = exported(tmp_path, "all.ply").results["points"]
    assert exported(tmp_path, "some.ply", stride=4).results["points"] == pytest.approx(all_points / 16, rel=0.05)


def test_discs_lie_in_the_wall_and_turn_to_the_panorama(tmp_path: Path) -> None:
    exported(tmp_path, "hall.ply", format="splats")
    discs = gsply.plyread(tmp_path / "hall.ply")
    places = discs.means @ OPENCV
    assert off_wall(places).max() < 1e-4
    axes = OPENCV @ rotation_from_quaternion(discs.quats.astype(np.float64))
    np.testing.assert_allclose((axes[..., 2] * places).sum(-1), -RADIUS, atol=0.05)
    radius = np.exp(discs.scales)
    assert (radius[:, 2] < 0.02 * radius[:, :2].min(axis=1)).all()
    np.testing.assert_allclose(0.5 + 0.28209479 * discs.sh0, wall_colour(places) / 255, atol=0.01)
    np.testing.assert_allclose(1 / (1 + np.exp(-discs.opacities)), 0.99, atol=1e-6)


def test_a_disc_covers_its_pixel_on_a_slanted_floor() -> None:
    """Across the line of sight as wide as pixels are apart there, along it longer by the slant."""
    height = 1.6
    rho = np.maximum(-pixel_directions(*SIZE)[..., 1] / height, 0.05).astype(np.float32)
    pose = posed((1, 2, 3), 0.7, 0.2, -0.1)
    picture = np.zeros((*SIZE, 3), np.uint8)
    points = points_of(build_mesh(rho, Cut(0.5)), np.ones(SIZE), picture, pose, 1)
    local = pose.inverse().transform(points.position)
    distance = np.linalg.norm(local, axis=1)
    floor = (local[:, 1] < -height + 1e-4) & (distance < 4.0) & (local[:, 1] / distance > -0.99)
    spacing = distance[floor] / pixel_scale(SIZE)[0]
    cosine = height / distance[floor]
    np.testing.assert_allclose(points.radius[floor, 1], DISC_RADIUS_SHARE * spacing, rtol=1e-5)
    np.testing.assert_allclose(points.radius[floor, 0], DISC_RADIUS_SHARE * spacing / cosine, rtol=0.02)
    axes = rotation_from_quaternion(points.turn[floor])
    np.testing.assert_allclose(axes[..., 2], np.broadcast_to(pose.rotation[:, 1], axes[..., 2].shape), atol=0.02)
    away = (points.position - pose.position)[floor]
    away -= (away @ pose.rotation[:, 1])[:, None] * pose.rotation[:, 1]
    along = np.abs((axes[..., 0] * away).sum(-1)) / np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(along, 1, atol=0.01)


def test_normals_do_not_reach_across_cuts() -> None:
    rho = np.full(SIZE, 0.25, np.float32)
    rho[:, 40:80] = 1.0
    rho[10, 10] = rho[:, 20] = rho[30, :] = 2.0  # a point and lines of their own look back along their rays
    points = points_of(build_mesh(rho, Cut(0.1)), np.ones(SIZE), np.zeros((*SIZE, 3), np.uint8), Pose.identity(), 1)
    toward = -points.position / np.linalg.norm(points.position, axis=1, keepdims=True)
    assert (points.normal * toward).sum(-1).min() > 0.98


def test_the_sky_is_left_out_or_lies_on_the_dome(tmp_path: Path) -> None:
    job = job_in(tmp_path, "sky.ply", chain=CHAIN[:2], dome=50.0)
    open_to_the_sky(tmp_path, 20)
    run_export(plan_export(job))
    assert off_wall(trimesh.load(tmp_path / "sky.ply").vertices).max() < 1e-4
    run_export(plan_export(replace(job, output=tmp_path / "discs.ply", format="splats")))
    places = gsply.plyread(tmp_path / "discs.ply").means @ OPENCV
    is_sky = off_wall(places) > 1.0
    distances = [np.linalg.norm(places[is_sky] - pose.position, axis=1) for pose in CHAIN[:2]]
    np.testing.assert_allclose(np.min(np.abs(np.array(distances) - 50.0), axis=0), 0, atol=1e-3)
    assert is_sky.any()


def test_nothing_but_sky_is_an_error_where_it_is_left_out(tmp_path: Path) -> None:
    job = job_in(tmp_path, "sky.ply", chain=CHAIN[:2], dome=50.0)
    open_to_the_sky(tmp_path, SIZE[0])
    with pytest.raises(InputError, match="nearer than 50 m, got sky or masks everywhere"):
        run_export(plan_export(job))
    assert not (tmp_path / "sky.ply").exists()


def test_equal_jobs_make_equal_files(tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply"):
        exported(tmp_path, name, format="splats", stride=3)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
