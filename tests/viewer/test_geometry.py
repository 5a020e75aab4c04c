"""A browser shows what the renderer shows: the same surfaces, the same colours, the same frames."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from interpolation_samples import tour_job
from omnisyn_cli.evaluation.scene_files import write_scene
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, blend_layers, view_weights
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.geometry.pose import Pose, slerp
from omnisyn_cli.geometry.sampling import rotated_image, sample_bilinear
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.interpolation.loading import PairSurfaces, tour_surfaces
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.viewer import contents
from omnisyn_cli.interpolation.viewer.contents import CORRECTION_SCALE, NO_CORRECTION, TourPacker, correction_of
from omnisyn_cli.interpolation.viewer.packing import packed_map
from omnisyn_cli.interpolation.viewer.page import write_page
from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view
from omnisyn_cli.pipeline.config import FALLBACKS, RunConfig, make_method
from omnisyn_cli.scenes import generate_scene, sample_path
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import KnownDepth, View
from synthesis_samples import ws_psnr
from viewer.browser import Launch, WalkPage, look, pinhole_rays

SIZE = (256, 512)
FARTHEST = 1e7  # Metres; Embree knows no infinity.


@dataclass(frozen=True)
class Shot:
    """A walk through a room with its true depth, in a browser."""

    plan: TourPlan
    pair: PairSurfaces
    packer: TourPacker
    page: WalkPage
    opened: Any

    @property
    def views(self) -> list[View]:
        return [replace(surface.view, known_depth=surface.depth) for surface in self.pair.surfaces]

    def pose(self, t: float) -> Pose:
        first, second = (view.pose for view in self.views)
        return Pose(slerp(first.rotation, second.rotation, t), (1 - t) * first.position + t * second.position)


def taken(folder: Path, opened: Any, *, gain: float = 1.0, tilt: float = 0.0, **changes: Any) -> Shot:
    """A room, its second photograph exposed otherwise, both tilted, and a job with some changes."""
    scene, names = generate_scene("room", 3), ("0.png", "1.png")
    write_scene(folder, scene, sample_path(scene, 3, 2, baseline=0.8, tilt=tilt), names, SIZE, 2)
    if gain != 1.0:
        file = str(folder / names[1])
        cv2.imwrite(file, np.rint(255 * np.clip((cv2.imread(file) / 255) ** 2.2 * gain, 0, 1) ** (1 / 2.2)))
    job = tour_job(ViewJob, folder, [folder / name for name in names], "walk.html", **changes)
    plan = plan_view(job)
    (pair,) = tour_surfaces(plan)
    packer = TourPacker(plan, is_lossless=True)
    packer.add(pair)
    write_page(job.output, packer.manifest(), packer.blocks.contents)
    return Shot(plan, pair, packer, WalkPage(opened, job.output).wait(), opened)


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory, launch: Launch) -> Iterator[Shot]:
    with launch() as opened:
        made = taken(tmp_path_factory.mktemp("room"), opened)
        yield made
        assert made.page.errors == []


def traced(pair: PairSurfaces, view: int, eye: Pose, rays: np.ndarray) -> np.ndarray:
    """Inverse depth along rays, by Embree through the renderer's triangles; negative where none is hit."""
    construction = pytest.importorskip("embreex.mesh_construction")
    core = pytest.importorskip("embreex.rtcore_scene")
    triangles = pair.surfaces[view].mesh.triangles()
    depth = 1.0 / np.maximum(triangles.inverse_depth, 1.0 / FARTHEST)
    points = (eye.inverse() @ pair.surfaces[view].view.pose).transform(triangles.direction * depth[..., None])
    area = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    front = (area * points[:, 0]).sum(axis=-1) > 0  # clockwise from the eye, as the renderer has them
    scene = core.EmbreeScene()
    construction.TriangleMesh(scene, np.ascontiguousarray(points[front], np.float32))
    flat = np.ascontiguousarray(rays.reshape(-1, 3), np.float32)
    hit = scene.run(np.zeros_like(flat), flat, query="DISTANCE")
    return np.where(hit >= 1e30, -1.0, 1.0 / hit).reshape(rays.shape[:2])


@pytest.mark.parametrize("aside", [(0, 0, 0), (0.2, 0.1, -0.1)], ids=["on the way", "beside it"])
def test_surfaces_are_the_renderer_s(shot: Shot, aside: tuple[float, float, float]) -> None:
    eye = Pose(look(75, -20), shot.pose(0.4).position + np.array(aside))
    size, fov = (160, 240), 80
    _, found = shot.page.capture(eye.rotation, eye.position, fov, size)
    rays = pinhole_rays(size, fov)
    for view in (0, 1):
        expected = traced(shot.pair, view, eye, rays)
        both = (expected >= 0) & (found[view] >= 0)
        assert ((expected >= 0) == (found[view] >= 0)).mean() > 0.995
        off = np.abs(found[view] - expected)[both] / np.maximum(expected[both], 1e-3)  # a kilometre
        assert (off < 1e-3).mean() >= 0.995
        assert both.mean() > 0.5


def silhouettes(depths: list[np.ndarray]) -> np.ndarray:
    """Pixels within two of one where either inverse depth jumps, or something ends."""
    found = np.zeros(depths[0].shape, np.uint8)
    for rho in depths:
        low, high = cv2.erode(rho, np.ones((3, 3))), cv2.dilate(rho, np.ones((3, 3)))
        found |= ((high - low) > 0.04 * np.maximum(high, 1e-3)).astype(np.uint8)
    return cv2.dilate(found, np.ones((5, 5), np.uint8)) > 0


def shown(shot: Shot, view: int, eye: Pose, rays: np.ndarray, rho: np.ndarray) -> LayerArrays:
    """What the photograph has where a surface is seen, weighted by the mesh's trust."""
    surface = shot.pair.surfaces[view]
    seen = eye.inverse() @ surface.view.pose
    directions = (rays - np.maximum(rho, 0)[..., None] * seen.position) @ seen.rotation
    image = np.asarray(surface.view.image, np.float64)
    row, col = direction_to_pixel(directions, surface.mesh.size)
    rows, cols = surface.mesh.quads.shape
    down, right = row - np.floor(row) >= 0.5, col - np.floor(col) >= 0.5
    quad = np.clip(np.floor(row).astype(int), 0, rows - 1), np.floor(col).astype(int) % cols
    surface_confidence = surface.mesh.surface_confidence[(*quad, 2 * down + right)]
    colour = sample_bilinear(image, directions)
    return LayerArrays(
        colour, np.where(rho >= 0, surface_confidence, 0.0), rho.astype(np.float64), np.asarray(seen.position)
    )


def test_colours_are_those_of_the_blend_rule(shot: Shot) -> None:
    """With smooth photographs, in which every way to interpolate finds the same."""
    smooth = [
        np.ascontiguousarray(0.5 + 0.4 * np.sin(pixel_directions(*SIZE) @ np.array(waves)).clip(-1, 1))
        for waves in ([[3, 1, 0], [0, 2, 3], [1, 0, 2]], [[1, 2, 3], [2, 0, 1], [0, 3, 1]])
    ]
    surfaces = [
        replace(
            surface, view=replace(surface.view, image=np.rint(255 * image).astype(np.uint8) / 255, image_uint8=None)
        )
        for surface, image in zip(shot.pair.surfaces, smooth, strict=True)
    ]
    painted = replace(shot, pair=replace(shot.pair, surfaces=(surfaces[0], surfaces[1])))
    packer = TourPacker(shot.plan, is_lossless=True)
    packer.add(painted.pair)
    file = shot.plan.job.output.with_name("smooth.html")
    write_page(file, packer.manifest(), packer.blocks.contents)
    eye, size, fov, t = Pose(look(200, 10), shot.pose(0.35).position), (150, 200), 70, 0.35
    colours, depths = WalkPage(shot.opened, file).wait().capture(eye.rotation, eye.position, fov, size)
    rays = pinhole_rays(size, fov)
    first, second = (shown(painted, view, eye, rays, depths[view]) for view in (0, 1))
    picture, weight = blend_layers(first, second, view_weights(first, second, rays, BlendRule.at(t)))
    expected = np.ascontiguousarray(picture, np.float32)
    HoleFiller(size)(expected, np.ascontiguousarray(weight, np.float32))
    inner = ~silhouettes(depths)
    assert inner.mean() > 0.5
    off = np.abs(colours - 255.0 * expected).max(axis=-1)[inner]
    assert (off <= 2.0).mean() > 0.998
    assert off.mean() < 0.7


def likeness(shot: Shot, t: float) -> float:
    """WS-PSNR of six faces and of the frame of a video whose edges are sampled once, as those on a screen are."""
    method = make_method(RunConfig(cut=shot.plan.config.cut, edges=False), SIZE, estimator=KnownDepth())
    frame = method.prepare(0, shot.views).frame(Waypoint(segment=0, t=t, pose=shot.pose(t))).image
    return ws_psnr(shot.page.unfolded(shot.pose(t), SIZE), np.clip(frame, 0, 1))


@pytest.mark.parametrize("t", [0.25, 0.5, 0.75])
def test_six_faces_are_the_frame_of_the_video(shot: Shot, t: float) -> None:
    assert likeness(shot, t) >= 40.0


@pytest.mark.parametrize(
    "changes", [{"gain": 0.6}, {"tilt": 0.4}, {"nadir": 0.5}], ids=["other exposure", "tilted", "masked"]
)
def test_so_they_are_of_pairs_that_are_taken_otherwise(shot: Shot, tmp_path: Path, changes: dict[str, float]) -> None:
    other = taken(tmp_path, shot.opened, **changes)
    assert likeness(other, 0.4) >= 38.0
    assert (other.pair.cross_check.curve.is_identity, other.packer.manifest()["panoramas"][0]["mask"] is None) == (
        "gain" not in changes, "nadir" not in changes,
    )  # fmt: skip
    other.page.page.context.close()


def test_a_doubtful_pair_is_a_dissolve_of_both_photographs(shot: Shot, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(FALLBACKS, "auto", 99.0)
    faded = taken(tmp_path, shot.opened)
    pose = faded.pose(0.25)
    first, second = (rotated_image(view.image, view.pose.rotation, pose.rotation, SIZE) for view in faded.views)
    assert ws_psnr(faded.page.unfolded(pose, SIZE), 0.75 * first + 0.25 * second) >= 38.0
    faded.page.page.context.close()


def test_half_way_the_page_has_what_the_network_changes(shot: Shot) -> None:
    """Its correction takes a frame by rules most of the way to that of the video."""
    config = replace(shot.plan.config, edges=False)
    assert correction_of(shot.plan, shot.pair) is None
    correction = correction_of(replace(shot.plan, config=replace(config, fusion="network")), shot.pair)
    waypoint = Waypoint(0, 0.5, Pose(np.eye(3), shot.pose(0.5).position))
    by_rule, fused = (
        make_method(replace(config, fusion=fusion), SIZE, estimator=KnownDepth())
        .prepare(0, shot.views).frame(waypoint).image.copy()
        for fusion in ("geometric", "network")
    )  # fmt: skip
    corrected = by_rule + (correction.astype(np.float32) - NO_CORRECTION) / CORRECTION_SCALE
    assert ws_psnr(corrected, fused) > ws_psnr(by_rule, fused) + 6.0


def test_a_correction_is_added_where_it_lies_and_fades_towards_the_ends(shot, monkeypatch) -> None:
    """Red on the right of the world's −z: by 20 levels half way, by 10 at a quarter, and not on the left."""
    red = np.full((*SIZE, 3), NO_CORRECTION, np.uint8)
    red[:, SIZE[1] // 2 :, 0] += 10
    monkeypatch.setattr(contents, "correction_of", lambda plan, pair: red)
    packer = TourPacker(shot.plan, is_lossless=True)
    packer.add(shot.pair)
    file = shot.plan.job.output.with_name("corrected.html")
    write_page(file, packer.manifest(), packer.blocks.contents)
    page = WalkPage(shot.opened, file).wait()
    for yaw, t, levels in ((90, 0.5, 20), (90, 0.25, 10), (-90, 0.5, 0)):
        seen = [
            one.capture(look(yaw, 10), shot.pose(t).position, 60, (100, 100))[0].astype(float)
            for one in (shot.page, page)
        ]
        changes = (seen[1] - seen[0]).reshape(-1, 3)
        np.testing.assert_allclose(np.median(changes, axis=0), (levels, 0, 0), atol=1)


@pytest.mark.parametrize("end", [0, 1])
def test_at_a_panorama_it_is_the_photograph(shot: Shot, end: int) -> None:
    assert ws_psnr(shot.page.unfolded(shot.pose(end), SIZE), shot.views[end].image) >= 45.0


def test_maps_are_unpacked_exactly(shot: Shot) -> None:
    for k, surface in enumerate(shot.packer.manifest()["surfaces"]):
        for name in ("inverseDepth", "quads", "trust"):
            if surface[name] is None:
                continue
            wanted = shot.packer.blocks.contents[surface[name]["block"]]
            script = f"omnisyn.page.world.blocks.map(omnisyn.page.world.walk.surfaces[{k}].{name})"
            values = np.array(shot.page.page.evaluate(f"{script}.then((map) => Array.from(map))"))
            kind = np.uint16 if surface[name]["depth"] == 2 else np.uint8
            values = values.reshape(surface[name]["rows"], surface[name]["cols"]).astype(kind)
            assert zlib.decompress(packed_map(values)) == zlib.decompress(wanted)


def test_tiles_out_of_sight_are_not_drawn(shot: Shot) -> None:
    drawn = []
    for fov in (20, 120):
        shot.page.capture(look(0, 0), shot.pose(0.5).position, fov, (64, 64))
        drawn.append(shot.page.page.evaluate("omnisyn.page.renderer.drawn"))
    whole = 2 * shot.page.page.evaluate("omnisyn.page.world.things.get('surface 0').triangles")
    assert drawn[0] < drawn[1] < 0.9 * whole


def test_a_headset_s_eyes_see_what_captures_show(shot: Shot) -> None:
    """As WebXR asks for it, by a made-up session: an eye that is moved, turned and looks askew through its lens."""
    side, half = 96, np.tan(np.radians(40))
    matrix = [1 / half, 0, 0, 0, 0, 1 / half, 0, 0, 0.25, -0.1, -1, -1, 0, 0, -0.2, 0]  # columns
    s, c = np.sin(0.2), np.cos(0.2)
    view = {
        "projectionMatrix": matrix,
        "transform": {"position": {"x": 0.05, "y": 0.1, "z": -0.1}, "orientation": {"x": 0, "y": s, "z": 0, "w": c}},
    }
    found = shot.page.page.evaluate(
        """([view, side]) => {
            const page = omnisyn.page;
            const gl = page.gl;
            Object.assign(page.walker, { s: 0.5, yaw: 0.3, beside: [0, 0, 0] });
            [page.canvas.width, page.canvas.height] = [2 * side, side];
            const baseLayer = { framebuffer: null, getViewport: () => ({ x: side, y: 0, width: side, height: side }) };
            page.headset.draw({ renderState: { baseLayer } }, { views: [view] });
            const pixels = new Uint8Array(4 * side * side);
            gl.readPixels(side, 0, side, side, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
            return Array.from(pixels);
        }""",
        [view, side],
    )
    seen = np.array(found, np.uint8).reshape(side, side, 4)[::-1, :, :3].astype(np.float32)
    turn, head = look(np.degrees(0.3), 0), look(-np.degrees(0.4), 0)
    position = shot.pose(0.5).position + turn @ np.array([0.05, 0.1, -0.1])
    whole, _ = shot.page.capture(turn @ head, position, 120, (512, 512))
    place = (np.arange(side) + 0.5) * 2 / side - 1
    x, y = np.meshgrid((place + 0.25) * half, (-place - 0.1) * half)  # slopes of rays through the askew lens
    reach = np.tan(np.radians(60))
    col, row = (((1 + slope / reach) * 256 - 0.5).astype(np.float32) for slope in (x, -y))
    expected = cv2.remap(whole.astype(np.float32), col, row, cv2.INTER_LINEAR)
    assert np.median(np.abs(seen - expected)) <= 2.0
    assert np.abs(seen - expected).mean() < 6.0
