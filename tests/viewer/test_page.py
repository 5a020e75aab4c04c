"""Pages hold together, nothing is fetched, names of files do no harm; what is packed is what was there."""

import base64
import hashlib
import json
import re
import zlib
from pathlib import Path
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interpolation_samples import CHAIN, edit_poses, listing, tour_job
from omnisyn_cli.errors import InputError, OutputPathError, PoseError
from omnisyn_cli.fusion.exposure_curve import ExposureCurve
from omnisyn_cli.interpolation.viewer import packing
from omnisyn_cli.interpolation.viewer import run as walk_run
from omnisyn_cli.interpolation.viewer.contents import _gains
from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view, run_view
from omnisyn_cli.io import write_image
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.shade import make_confidence_map
from omnisyn_cli.render.texture import make_texture
from synthesis_samples import posed, write_hall
from viewer.browser import serving


def made(folder: Path, images: list[Path], *, is_folder: bool = False, **changes: object) -> Path:
    output = folder / ("walk" if is_folder else "walk.html")
    run_view(plan_view(tour_job(ViewJob, folder, images, output.name, is_folder=is_folder, **changes)))
    return output


def manifest_of(page: str) -> dict:
    found = re.search(r'<script type="application/json" id="walk">(.*?)</script>', page, re.DOTALL)
    assert found
    return json.loads(found.group(1))


def test_the_policy_admits_the_script_and_the_style_and_nothing_else(tmp_path: Path) -> None:
    page = made(tmp_path, write_hall(tmp_path, CHAIN)).read_text()
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="(.*?)"', page)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    for element, name in (('script type="module"', "script-src"), ("style", "style-src")):
        (inside,) = re.findall(rf"<{element}>(.*?)</{element[:6].strip()}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(inside.encode()).digest()).decode()
        assert rules[name] == f"'sha256-{digest}'"
    assert (rules["default-src"], rules["connect-src"]) == ("'none'", "'none'")
    assert not re.search(r"https?://|\son\w+=|\bsrc=|\bhref=", page)


def test_blocks_are_those_that_the_manifest_names(tmp_path: Path) -> None:
    page = made(tmp_path, write_hall(tmp_path, CHAIN)).read_text()
    manifest = manifest_of(page)
    assert [link["panoramas"] for link in manifest["links"]] == [[0, 1], [1, 2]]
    named = {level["block"] for panorama in manifest["panoramas"] for level in panorama["photo"]}
    for surface in manifest["surfaces"]:
        named |= {surface[key]["block"] for key in ("inverseDepth", "quads", "trust") if surface[key]}
    named.add(manifest["dollhouse"]["inverseDepth"]["block"])
    blocks = {int(k): base64.b64decode(text) for k, text in re.findall(r'id="block-(\d+)">(.*?)</script>', page)}
    assert set(blocks) == named
    first = blocks[manifest["panoramas"][0]["photo"][-1]["block"]]
    assert first.startswith(b"\xff\xd8\xff")
    for pose, panorama in zip(CHAIN, manifest["panoramas"], strict=True):
        np.testing.assert_allclose(panorama["position"], pose.position)
        np.testing.assert_allclose(np.reshape(panorama["rotation"], (3, 3)), pose.rotation, atol=1e-12)


def test_names_are_text_whatever_they_hold(tmp_path: Path) -> None:
    folder = tmp_path / "a place"
    folder.mkdir()
    images = write_hall(folder, CHAIN[:2])
    odd = folder / "a <i>&amp;<!--\u2028.png"
    images[0].rename(odd)
    edit_poses(folder, lambda panoramas: panoramas.update({odd.name: panoramas.pop(images[0].name)}))
    page = made(folder, [odd, images[1]]).read_text()
    assert "<i>" not in page
    assert "<!--" not in page
    assert manifest_of(page)["panoramas"][0]["name"] == odd.name


def test_a_folder_is_served_to_this_machine(tmp_path: Path) -> None:
    folder = made(tmp_path, write_hall(tmp_path, CHAIN[:2]), is_folder=True)
    page = (folder / "index.html").read_text()
    manifest = json.loads((folder / "walk.json").read_text())
    assert "connect-src 'self'" in page
    assert "block-0" not in page
    assert set(listing(folder)) == {"index.html", "omnisyn-walk.js", "walk.json", *manifest["files"]}
    with serving(folder) as address:
        assert address.startswith("http://127.0.0.1:")
        for name in ("", "omnisyn-walk.js", "walk.json", manifest["files"][0]):
            with urlopen(address + name) as answer:  # noqa: S310 - this machine
                assert answer.read() == (folder / (name or "index.html")).read_bytes()


def test_what_is_too_large_for_one_file_says_so_and_leaves_nothing(tmp_path, monkeypatch) -> None:
    images = write_hall(tmp_path, CHAIN)
    before = listing(tmp_path)
    monkeypatch.setattr(walk_run, "MAX_PAGE_BYTES", 4000)
    with pytest.raises(OutputPathError, match="--folder"):
        made(tmp_path, images)
    assert listing(tmp_path) == before
    made(tmp_path, images, is_folder=True)


@pytest.mark.parametrize(
    ("output", "words"), [("walk.mp4", "ending in .html"), ("p0.html", "one that exists"), ("no/walk.html", "folder")]
)
def test_unusable_places_are_refused_before_any_work(tmp_path: Path, output: str, words: str) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    (tmp_path / "p0.html").write_text("mine")
    with pytest.raises(OutputPathError, match=words):
        plan_view(tour_job(ViewJob, tmp_path, images, output))
    assert (tmp_path / "p0.html").read_text() == "mine"


def test_too_little_is_refused(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    with pytest.raises(InputError, match="two or more"):
        made(tmp_path, images[:1])
    images[1].rename(tmp_path / "other.png")
    with pytest.raises(PoseError, match=r"other\.png"):
        made(tmp_path, [images[0], tmp_path / "other.png"])


def test_photographs_are_reduced_to_the_texture(tmp_path: Path) -> None:
    options = {"texture": 64, "is_lossless": True}
    run_view(plan_view(tour_job(ViewJob, tmp_path, write_hall(tmp_path, CHAIN[:2]), "walk.html", **options)))
    photo = manifest_of((tmp_path / "walk.html").read_text())["panoramas"][0]["photo"][-1]
    assert (photo["width"], photo["height"], photo["type"]) == (64, 32, "image/png")


def test_gains_take_a_picture_to_the_other_ones_exposure() -> None:
    """What a page computes, stops in proportion to the share of the way, is the program's own table."""
    curve = ExposureCurve(np.linspace(-0.8, 0.9, 18).reshape(3, 6))
    both = _gains(curve)
    stored = np.linspace(0.0, 1.0, 256)
    for of_second, gains in zip((False, True), both, strict=True):
        stops = np.reshape(gains, (256, 3)).T
        light = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
        moved = light * np.exp2((0.3 - of_second) * stops)
        expected = curve.table(0.3, of_second=of_second)
        back = np.where(moved <= 0.0031308, 12.92 * moved, 1.055 * moved ** (1 / 2.4) - 0.055)
        places = np.linspace(0.0, 1.0, expected.shape[1])
        found = np.stack([np.interp(stored, places, channel) for channel in expected])
        np.testing.assert_allclose(np.minimum(back, 1.0), found, atol=2e-3)
    assert _gains(ExposureCurve(np.zeros((3, 6)))) is None


def test_panoramas_at_one_place_make_a_walk(tmp_path: Path) -> None:
    images = write_hall(tmp_path, [posed((0, 0, 0)), posed((0, 0, 0), heading=0.4)], with_depth=False)
    assert len(manifest_of(made(tmp_path, images).read_text())["links"]) == 1


def test_tiny_panoramas_make_a_walk(tmp_path: Path) -> None:
    made(tmp_path, write_hall(tmp_path, CHAIN[:2], size=(4, 8)))


def test_rings_lie_on_the_ground_below(tmp_path: Path) -> None:
    """A ball of four metres: two and a half above its lowest point that is the height, however the camera was held."""
    images = write_hall(tmp_path, [posed((0, -1.5, 0), pitch=1.2), posed((0.3, -1.5, 0), roll=-1.0)])
    heights = [panorama["eyeHeight"] for panorama in manifest_of(made(tmp_path, images).read_text())["panoramas"]]
    np.testing.assert_allclose(heights, 2.45, atol=0.15)


def test_a_shorter_walk_in_its_place_leaves_nothing_of_the_longer_one(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN)
    longer = listing(made(tmp_path, images, is_folder=True))
    (tmp_path / "walk" / "mine.txt").write_text("mine")
    walk = listing(made(tmp_path, images[:2], is_folder=True, overwrite=True))
    files = json.loads(walk["walk.json"])["files"]
    assert len(files) < len(longer) - 3
    assert set(walk) == {*files, "index.html", "omnisyn-walk.js", "walk.json", "mine.txt"}


@pytest.mark.parametrize("fallback", ["fail", "crossfade", "auto", "none"])
def test_a_doubtful_pair_is_given_up_or_faded_if_that_is_asked_for(tmp_path: Path, fallback: str) -> None:
    """Two pictures of different places: their depth files say nothing true of the other one."""
    images = write_hall(tmp_path, CHAIN[:2])
    write_image(images[1], np.random.default_rng(0).integers(0, 256, (64, 128, 3), np.uint8))
    if fallback == "fail":
        with pytest.raises(InputError, match="confidence"):
            made(tmp_path, images, fallback=fallback)
        assert not (tmp_path / "walk.html").exists()
        return
    (link,) = manifest_of(made(tmp_path, images, fallback=fallback).read_text())["links"]
    assert link["isCrossFade"] == (fallback != "none")


@pytest.mark.parametrize("is_chain", [False, True])
def test_links_share_one_surface_for_each_panorama(tmp_path: Path, is_chain: bool) -> None:
    manifest = manifest_of(made(tmp_path, write_hall(tmp_path, CHAIN), is_chain=is_chain).read_text())
    assert len(manifest["links"]) == 2
    assert len(manifest["surfaces"]) == 3


def unpacked(packed: bytes, shape: tuple[int, int], dtype: type) -> np.ndarray:
    """As web/blocks.js does it: planes of bytes, then sums along rows and columns modulo the type."""
    planes = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(np.dtype(dtype).itemsize, -1)
    rest = np.ascontiguousarray(planes.T).view(f"<u{planes.shape[0]}").reshape(shape)
    return np.cumsum(np.cumsum(rest, axis=0, dtype=dtype), axis=1, dtype=dtype)


@given(st.integers(1, 9), st.integers(1, 9), st.sampled_from([np.uint8, np.uint16]), st.integers(0, 2**32 - 1))
def test_maps_come_back_exactly(rows: int, cols: int, dtype: type, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (rows, cols), dtype, endpoint=True)
    np.testing.assert_array_equal(unpacked(packing.packed_map(values), (rows, cols), dtype), values)


def test_a_plane_takes_next_to_nothing() -> None:
    rows, cols = np.mgrid[:256, :512]
    assert len(packing.packed_map((37 * rows + 11 * cols).astype(np.uint16))) < 1000


def test_inverse_depths_are_off_by_less_than_one_part_in_their_code() -> None:
    rho = np.geomspace(1e-5, 7.0, 4096, dtype=np.float32).reshape(64, 64)
    codes, peak = packing.inverse_depth_codes(rho)
    decoded = peak * (codes / (packing.NO_SURFACE_CODE - 1.0)) ** 2
    assert (np.abs(decoded - rho) <= rho / np.maximum(codes, 1) * 1.01).all()
    assert codes.max() == packing.NO_SURFACE_CODE - 1
    assert peak == pytest.approx(7.0)


def test_infinitely_far_and_no_surface_have_codes_of_their_own() -> None:
    codes, peak = packing.inverse_depth_codes(np.array([[0.0, -1e-9], [1e-7, 2.0]], np.float32))
    assert codes.tolist() == [[0, packing.NO_SURFACE_CODE], [round(65534 * (1e-7 / peak) ** 0.5), 65534]]
    assert (packing.inverse_depth_codes(np.zeros((2, 4), np.float32))[0] == 0).all()


def test_trust_is_that_of_the_renderer() -> None:
    rho = np.full((16, 32), 0.2, np.float32)
    rho[5:9, 10:14] = 1.0
    mesh = build_mesh(rho)
    codes = packing.confidence_codes(mesh)
    expected = make_confidence_map(mesh, make_texture(np.zeros((16, 32, 3), np.float32))).values.reshape(32, 65)[
        1:-1, 1:
    ]
    np.testing.assert_allclose((codes[1:-1] / 255.0) ** 2, expected, atol=0.004)
    assert packing.confidence_codes(build_mesh(np.full((16, 32), 0.2, np.float32))) is None


def test_lossless_photographs_are_the_samples_and_others_nearly() -> None:
    samples = cv2.resize(np.random.default_rng(0).integers(0, 256, (8, 16, 3), np.uint8), (128, 64))
    for is_lossless, most in ((True, 0.0), (False, 6.0)):
        blocks = packing.Blocks()
        kind = blocks.add_photograph(samples, is_lossless=is_lossless)
        decoded = cv2.imdecode(np.frombuffer(blocks.contents[0], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert np.abs(decoded.astype(float) - samples).mean() <= most
        assert (kind["width"], kind["height"]) == (128, 64)
        assert kind["type"] == ("image/png" if is_lossless else "image/jpeg")


@pytest.mark.parametrize(
    ("width", "has_half", "widths"),
    [(64, True, [64]), (1152, True, [768, 1152]), (2302, True, [768, 2302]), (4096, True, [768, 2048, 4096]),
     (4096, False, [768, 4096])],
)  # fmt: skip
def test_photographs_have_levels_from_small_to_large(width: int, has_half: bool, widths: list[int]) -> None:
    assert packing.level_widths(width, has_half=has_half) == widths


def test_a_preview_is_small_and_equal_blocks_are_kept_once(tmp_path: Path) -> None:
    blocks = packing.Blocks(tmp_path)
    samples = cv2.resize(np.random.default_rng(0).integers(0, 256, (64, 128, 3), np.uint8), (1536, 768))
    levels = blocks.add_levels(samples, is_lossless=True)
    assert [(level["width"], level["height"], level["type"]) for level in levels] == [
        (768, 384, "image/jpeg"), (1536, 768, "image/png"),
    ]  # fmt: skip
    kept = [file.stat().st_size for file in sorted(tmp_path.iterdir())]
    assert kept[0] < 64_000
    assert blocks.add_levels(samples, is_lossless=True) == levels
    assert (len(blocks), blocks.size) == (2, sum(kept))


def test_masks_shrink_with_their_photographs() -> None:
    mask = np.ones((32, 64), bool)
    mask[16:] = False
    np.testing.assert_array_equal(packing.packed_mask(mask, 64), np.where(mask, 255, 0))
    small = packing.packed_mask(mask, 32)
    assert small.shape == (16, 32)
    np.testing.assert_array_equal(small, np.where(mask[::2, ::2], 255, 0))
