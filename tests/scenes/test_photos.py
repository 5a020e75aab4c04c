from dataclasses import replace

import cv2
import numpy as np
import pytest
from scene_samples import builder, make

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import write_image
from omnisyn_cli.scenes import generate_scene, pack_photos, render_panorama, sample_path
from omnisyn_cli.scenes.materials import Material, Pattern, PhotoMapping, pack_materials
from omnisyn_cli.scenes.noise import cell_hash
from omnisyn_cli.scenes.shader import photo_at
from omnisyn_cli.scenes.textures import FacePoint
from omnisyn_cli.training.data import load_walk
from omnisyn_cli.training.walks import WalkConfig, make_walk_file


def photographs(count=4, seed=0):
    """Photographs of different shapes, no two alike, with structure at every size."""
    rng = np.random.default_rng(seed)
    images = []
    for k in range(count):
        coarse = rng.integers(0, 255, (6, 8, 3), np.uint8)
        size = (48 + 9 * k, 40 + 5 * k)
        image = cv2.resize(coarse, size, interpolation=cv2.INTER_NEAREST).astype(int)
        images.append(np.clip(image + rng.integers(-30, 30, image.shape), 0, 255).astype(np.uint8))
    return images


@pytest.fixture(scope="module")
def photos():
    return pack_photos(photographs())


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "photographs"
    path.mkdir()
    for k, image in enumerate(photographs()):
        write_image(path / f"{k}.png", image)
    return path


@fast_kernel(cache=False)
def hashed(i, j, seed):
    return cell_hash(i, j, seed)


@fast_kernel(cache=False)
def look_up(photos, materials, points, half, footprint, colours):
    for i in range(len(points)):
        point = FacePoint(points[i, 0], points[i, 1], half[0], half[1], 0.0, 0.0, 0.0, 3)
        colours[i, 0], colours[i, 1], colours[i, 2] = photo_at(photos, materials[0], point, footprint)


def with_photo(materials, photo, use, wide, seed=17, patched=False):
    for name, value in (("", photo), ("_mapping", use), ("_width", wide), ("_seed", seed)):
        materials[f"photo{name}"] = value
    materials["has_patches"] = patched
    return materials


def looked_at(photos, use, *places, half=(1.5, 1.0), footprint=1e-6, photo=1, patched=False):
    materials = with_photo(pack_materials([Material()]), photo, use, 2.0, patched=patched)
    points = np.array(places, dtype=float)
    look_up(photos, materials, points, half, footprint, colours := np.empty((len(points), 3)))
    return colours


def bilinear(image, row, col):
    """Of the light of a photograph that is mirrored at its edges, by plain indexing."""
    light = np.pad(np.square(image / 255.0), ((200, 200), (200, 200), (0, 0)), mode="symmetric")
    top, left = int(np.floor(row)), int(np.floor(col))
    a, b = row - top, col - left
    corner = light[top + 200 : top + 202, left + 200 : left + 202]
    return (1 - a) * ((1 - b) * corner[0, 0] + b * corner[0, 1]) + a * ((1 - b) * corner[1, 0] + b * corner[1, 1])


def test_a_tiled_photograph_is_mirrored_at_its_edges_and_stands_upright(photos):
    """As plain indexing into a mirrored picture says: right is right, up is up, metres are metres."""
    image = photographs()[1]
    height, width = image.shape[:2]
    texel = 2.0 / width
    places = np.random.default_rng(0).uniform(-2.5, 2.5, (60, 2))
    found = looked_at(photos, PhotoMapping.TILED, *places)
    across, up = 2 * width * hashed(3, 1, 17), 2 * height * hashed(3, 2, 17)
    row, col = np.mod(up - places[:, 1] / texel, 2 * height), np.mod(across + places[:, 0] / texel, 2 * width)
    expected = [bilinear(image, r - 0.5, c - 0.5) for r, c in zip(row, col, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_fitted_photograph_covers_its_face_once_and_is_cropped_to_it(photos):
    image = photographs()[1]
    height, width = image.shape[:2]
    for hu, hv in ((1.5, 1.0), (0.5, 2.0), (1.0, 1.0)):
        texel = max(2 * hu / width, 2 * hv / height)
        places = [(u * hu, (1 + v) * hv) for u in (-0.97, 0.0, 0.6) for v in (-0.97, 0.1, 0.97)]
        expected = [
            bilinear(image, 0.5 * height - (v - hv) / texel - 0.5, 0.5 * width + u / texel - 0.5) for u, v in places
        ]
        found = looked_at(photos, PhotoMapping.FITTED, *places, half=(hu, hv))
        np.testing.assert_allclose(found, expected, atol=1e-9)
        inside = [(0.5 * height - (v - hv) / texel, 0.5 * width + u / texel) for u, v in places]
        assert all(0 < row < height and 0 < col < width for row, col in inside)


def test_a_wide_sample_sees_the_mean_light_of_a_photograph(photos):
    for photo, image in enumerate(photographs()):
        mean = np.square(image / 255.0).mean(axis=(0, 1))
        found = looked_at(photos, PhotoMapping.TILED, (0.3, 0.2), (5.0, -3.0), footprint=50.0, photo=photo)
        np.testing.assert_allclose(found, np.stack([mean, mean]), atol=0.02)


def test_detail_fades_with_the_footprint(photos):
    """The coarser a sample, the less it differs from its neighbours; nothing jumps between two mip levels."""
    places = np.random.default_rng(1).uniform(-3, 3, (200, 2))
    spread = [looked_at(photos, PhotoMapping.TILED, *places, footprint=f).std() for f in (0.01, 0.1, 0.3, 1.0, 4.0)]
    assert np.all(np.diff(spread) < 0)
    below, above = (looked_at(photos, PhotoMapping.TILED, *places, footprint=2.0 / 45 * f) for f in (1.999, 2.001))
    assert np.abs(above - below).max() < 2e-3


def test_patches_of_the_ground_are_turned_and_join_smoothly(photos):
    """Somewhere the plain tiling, elsewhere another one; from step to step no more change than within one of them."""
    line = [(0.004 * k, 0.37) for k in range(4000)]
    plain, patched = (looked_at(photos, PhotoMapping.TILED, *line, footprint=0.2, patched=p) for p in (False, True))
    same = np.isclose(plain, patched).all(axis=1)
    assert 0.1 < same.mean() < 0.9
    steps = [np.abs(np.diff(x, axis=0)).max() for x in (plain, patched)]
    assert steps[1] < 3 * steps[0]


def wall(pattern, **options):
    build = builder(ground=-2.0)
    build.ground_material = Material(Pattern.PLAIN, (0.5, 0.5, 0.5))
    build.box((-2, -1.5, -3.2), (2, 1.5, -3.0), Material(pattern, (0.9, 0.1, 0.1), grain=0.0, **options))
    return build.build("test")


def papered(scene, photos, use, row, wide=1.0):
    materials = scene.materials.copy()
    materials[row : row + 1] = with_photo(materials[row : row + 1], 1, use, wide, 5)
    return replace(scene, materials=materials, photos=photos)


def test_shapes_and_depth_are_those_of_the_procedural_scene(photos):
    for kind in ("street", "room"):
        plain, scene = generate_scene(kind, 1), generate_scene(kind, 1, photos)
        pose = sample_path(plain, 1, 2)[0]
        assert pose.almost_equals(sample_path(scene, 1, 2)[0])
        one, other = (render_panorama(s, pose, (32, 64), threads=1) for s in (plain, scene))
        np.testing.assert_array_equal(one[1], other[1])
        assert np.abs(one[0] - other[0]).mean() > 0.02


def test_equal_seeds_and_photographs_make_equal_scenes(photos):
    one, same = (generate_scene("room", 4, pack_photos(photographs())) for _ in range(2))
    np.testing.assert_array_equal(one.materials, same.materials)
    pose = sample_path(one, 4, 2)[0]
    pictures = [render_panorama(scene, pose, (24, 48), threads=1)[0].tobytes() for scene in (one, same)]
    assert pictures[0] == pictures[1]
    others = generate_scene("room", 4, pack_photos(photographs(seed=9)))
    assert pictures[0] != render_panorama(others, pose, (24, 48), threads=1)[0].tobytes()


def test_photographs_are_mixed_with_procedural_materials_and_used_for_everything():
    photos, shares, used, wide = pack_photos(photographs(9)), [], set(), []
    for seed in range(12):
        materials = generate_scene("street" if seed % 2 else "room", seed, photos).materials
        chosen = materials[materials["photo"] >= 0]
        shares.append(len(chosen) / len(materials))
        used |= set(zip(chosen["pattern"].tolist(), chosen["photo_mapping"].tolist(), strict=True))
        wide += chosen["photo_width"][chosen["photo_mapping"] == PhotoMapping.TILED].tolist()
        assert not (chosen["glow"] > 0).any()
        assert set(chosen["photo"]) <= set(range(9))
    assert 0.1 < min(shares) < max(shares) < 0.9
    expected = {Pattern.PLAIN, Pattern.FACADE, Pattern.ROAD, Pattern.PICTURE, Pattern.PLANKS, Pattern.TILES}
    assert expected <= {Pattern(pattern) for pattern, _ in used}
    assert {use for _, use in used} == {int(use) for use in PhotoMapping}
    assert max(wide) > 4 * min(wide)


def test_windows_stay_where_a_photograph_lies_under_a_facade(photos):
    """Under: the wall changes, the glass does not. Tiled: all of it changes."""
    scene = wall(Pattern.FACADE, second=(0.0, 0.0, 0.9), cell=(1.0, 1.5), detail=0.2)
    pictures = {
        use: render_panorama(scene if use is None else papered(scene, photos, use, 0), Pose.identity(), (64, 128))[0]
        for use in (None, PhotoMapping.UNDER, PhotoMapping.TILED)
    }
    plain = pictures[None]
    glass = (plain[..., 2] > 2 * plain[..., 0] + 0.1) & (np.abs(np.arange(128) - 63.5) < 16)
    assert glass.sum() > 30
    assert np.abs(pictures[PhotoMapping.UNDER] - plain)[glass].mean() < 0.05
    bare = plain[..., 0] > 2 * plain[..., 1] + 0.1
    assert np.abs(pictures[PhotoMapping.UNDER] - plain)[bare].mean() > 0.1
    assert np.abs(pictures[PhotoMapping.TILED] - plain)[glass].mean() > 0.15


def test_far_and_slanting_photographs_do_not_flicker():
    """One sample a pixel of a fine checkerboard on the ground differs little from thirty-six."""
    checks = np.kron((np.indices((32, 32)).sum(axis=0) % 2)[..., None], np.full((8, 8, 1), 255)).astype(np.uint8)
    photos = pack_photos([np.repeat(checks, 3, axis=2)] * 2)
    build = builder(ground=-1.6)
    build.ground_material = Material(Pattern.TILES, grain=0.0)
    scene = build.build("test")
    scene = papered(scene, photos, PhotoMapping.TILED, scene.shapes["material"][0, 0], wide=2.0)
    rough, fine = (render_panorama(scene, Pose.identity(), (96, 192), supersample=s, threads=1)[0] for s in (1, 6))
    far = slice(50, 66)
    assert np.abs(rough - fine)[far].mean() < 0.03
    assert rough[far].std() < 0.1
    assert fine[85:].std() > 0.15


def test_the_command_makes_scenes_of_a_folder(tmp_path, folder, omnisyn):
    pictures = {}
    for name, options in (("plain", ()), ("one", ("--textures", folder)), ("two", ("--textures", folder))):
        omnisyn.made(*make(tmp_path / name, "--kind", "room", "--frames", 1, "--seed", 3, *options))
        pictures[name] = (tmp_path / name / "0000.png").read_bytes()
    assert pictures["one"] == pictures["two"] != pictures["plain"]


def test_folders_without_photographs_are_refused_before_anything_is_written(tmp_path, folder, omnisyn):
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "notes.txt").write_text("none")
    assert "found none; put some into it" in omnisyn.refused(*make(tmp_path / "out", "--textures", empty))
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff no picture")
    assert "broken.jpg" in omnisyn.refused(*make(tmp_path / "out", "--textures", folder))
    for command in ("pool", "evidence", "fusion-pool"):
        omnisyn.refused("train", command, tmp_path / "out", "--textures", empty)
    omnisyn.misused(*make(tmp_path / "out", "--suite", "--textures", folder))


def test_a_pool_of_photographs_has_the_depth_of_the_procedural_one(tmp_path, folder):
    config = WalkConfig(size=(32, 64), kinds=("street",), views=2)
    plain, take_photograph = (
        load_walk(make_walk_file(tmp_path / name, 1, replace(config, textures=textures)))
        for name, textures in (("plain", None), ("photographed", str(folder)))
    )
    np.testing.assert_array_equal(plain.inverse_depth, take_photograph.inverse_depth)
    assert np.abs(plain.images.astype(int) - take_photograph.images).mean() > 3
