"""What a page knows of places: distances of points that are picked, with their error; and the tour from outside."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interpolation_samples import CHAIN, tour_job
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.interpolation.viewer.contents import GRID, stacked_surfaces
from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view, run_view
from omnisyn_cli.io import read_inverse_depth
from omnisyn_cli.poses.file import PosedPanorama, read_poses, write_poses
from synthesis_samples import PHASES, RADIUS, WAVES, open_to_the_sky, posed, write_hall
from viewer.browser import WalkPage

# metres from the top to the bottom of a picture of 640×400 and its middle, and the colours of three of its pixels
FLAT = """() => {
    const { page } = omnisyn, { reach, focus } = page.dollhouse.orbit, paper = new OffscreenCanvas(640, 400).getContext('2d');
    page.draw(1);
    paper.drawImage(page.canvas, 0, 0);
    return [reach, focus, [160, 320, 480].map((x) => [...paper.getImageData(x, 200, 1, 1).data.slice(0, 3)])];
}"""  # noqa: E501
ORBIT, RAYS = "omnisyn.page.dollhouse.orbit", "[[0.2, 0.4], [0.5, 0.5]].map((at) => omnisyn.page.rayAt(...at))"


def opened_walk(opened: Any, folder: Path, images: list[Path], **changes: Any) -> WalkPage:
    run_view(plan_view(tour_job(ViewJob, folder, images, "walk.html", **changes)))
    options = {"viewport": {"width": 640, "height": 400}, "offline": True, "reduced_motion": "reduce"}
    page = WalkPage(opened, folder / "walk.html", "#t=0&yaw=0&pitch=0&fov=80", has_touch=True, **options).wait()
    page.until("omnisyn.page.world.isReady(omnisyn.page.walker.link)")
    return page


@pytest.fixture(scope="module")
def walk(opened: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[WalkPage]:
    """In a ball of four metres, open to the sky; its depth is known."""
    folder = tmp_path_factory.mktemp("hall")
    images = write_hall(folder, CHAIN, (128, 256))
    open_to_the_sky(folder, 20, 3)
    yield (page := opened_walk(opened, folder, images, is_lossless=True))
    assert (page.errors, page.requests) == ([], [(folder / "walk.html").as_uri()])


def test_two_points_are_measured_by_click_touch_and_keys(walk: WalkPage) -> None:
    rays, eye = (np.array(walk.page.evaluate(what)) for what in (RAYS, "omnisyn.page.walker.position"))
    places = [eye + ray * (-(eye @ ray) + np.sqrt((eye @ ray) ** 2 + RADIUS**2 - eye @ eye)) for ray in rays]
    walk.page.click("#measure")
    for pick in (walk.page.mouse.click, walk.page.touchscreen.tap):
        pick(128, 160)
        walk.page.keyboard.press("Enter")
        metres, error, *heights = map(float, re.findall(r"[\d.-]+(?= m)", walk.page.text_content("#measured")))
        assert abs(metres - np.linalg.norm(places[1] - places[0])) <= error < 0.2
        assert heights[2] - heights[0] == pytest.approx(places[1][1] - places[0][1], abs=heights[1])
        assert heights[0] == pytest.approx(places[0][1] + RADIUS, abs=0.45)  # the floor of a ball is not flat
    walk.page.evaluate("omnisyn.page.lookAt({ pitch: 80 }), omnisyn.page.pickAt(0.5, 0.5)")
    assert walk.page.text_content("#measured").startswith("--")  # the sky
    walk.page.keyboard.press("r")
    assert not walk.page.is_visible("#measured")


def test_without_metres_nothing_is_measured(opened: Any, tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    write_poses(tmp_path / "poses.json", read_poses(tmp_path / "poses.json").panoramas, is_metric=False)
    walk = opened_walk(opened, tmp_path, images)
    walk.page.keyboard.press("r")
    assert "unit of the poses is unknown" in walk.page.text_content("#measured")


def test_estimated_distances_are_within_their_error(opened: Any, tmp_path: Path, omnisyn: Any) -> None:
    words = ("--kind", "room", "--seed", 5, "--frames", 2, "--baseline", 1, "--size", "512x256", "-q")
    omnisyn.made("scenes", "make", tmp_path, *words)
    depth, known = read_inverse_depth(tmp_path / "0000_depth.exr"), read_poses(tmp_path / "poses.json").panoramas
    write_poses(tmp_path / "poses.json", {name: PosedPanorama(each.pose) for name, each in known.items()})
    walk, errors = opened_walk(opened, tmp_path, [tmp_path / name for name in known], preset="fast"), []
    for yaw in range(0, 360, 30):
        look = f"omnisyn.page.lookAt({{ yaw: {yaw}, pitch: -10 }})"
        if found := walk.page.evaluate(f"({look}, omnisyn.page.pointAt(0.5, 0.5))"):
            seen = known["0000.png"].pose.inverse().transform(np.array(found["point"]))
            errors.append(abs(np.linalg.norm(seen) - 1 / sample_nearest(depth, seen)) / (2 * found["std"][0]))
    assert sum(error <= 1 for error in errors) >= max(6, 0.75 * len(errors))


def test_from_outside_everything_is_where_it_is_and_pins_lead_in(walk: WalkPage) -> None:
    """From straight above, the bottom of the ball has the colours of its places; its top is cut away."""
    walk.page.keyboard.press("o")
    walk.until(f"omnisyn.page.dollhouse.meshes.length === 3 && !{ORBIT}.flight")
    yaw, distance = walk.page.evaluate(f"[{ORBIT}.yaw, {ORBIT}.distance]")
    walk.page.keyboard.press("ArrowLeft")
    walk.page.mouse.wheel(0, 100)
    walk.until(f"{ORBIT}.yaw > {yaw} && {ORBIT}.distance > {distance}")
    walk.page.evaluate(f"Object.assign({ORBIT}, {{ yaw: 0, distance: 8 }})")
    walk.page.keyboard.press("t")
    reach, focus, colours = walk.page.evaluate(FLAT)
    for x, colour in zip((-160, 0, 160), colours, strict=True):
        east, south = focus[0] + (x + 0.5) * reach / 400, focus[2] + 0.5 * reach / 400
        place = np.array([east, -np.sqrt(RADIUS**2 - east**2 - south**2), south])
        np.testing.assert_allclose(np.array(colour) / 255, 0.5 + 0.4 * np.sin(place @ WAVES.T + PHASES), atol=0.06)
    assert walk.page.evaluate("omnisyn.page.dollhouse.triangles") < 3 * 20_000
    assert walk.walker("s") == walk.page.evaluate(f"{ORBIT}.distance = 20, 0")  # nobody walks meanwhile
    pins = walk.page.locator(".pin")
    for index, go in ((2, pins.nth(2).tap), (1, lambda: pins.nth(1).press("Enter"))):
        walk.page.evaluate("omnisyn.page.toggleOutside(true)")
        walk.until(f"omnisyn.page.dollhouse.isOpen && !{ORBIT}.flight")
        go()
        walk.until(f"omnisyn.page.walker.panorama === {index} && !document.body.hasAttribute('data-outside')")


def test_far_places_are_left_out_and_near_ones_left_to_who_sees_them_best() -> None:
    poses, rays = [posed((0, 0, 0)), posed((3, 0, 0))], pixel_directions(*GRID)
    depth = 4 / np.maximum(np.abs(rays[..., 2]), 1e-9)
    shown = stacked_surfaces([1 / depth] * 2, poses, [[0, 1]]).reshape(2, *GRID)
    assert (shown[:, depth > 9.01] < 0).all()
    east, is_level = depth * rays[..., 0], np.abs(depth * rays[..., 1]) < 0.5
    assert (shown[0, is_level & (np.abs(east - 5) < 1)] < 0).all()
    assert (shown[0, is_level & (np.abs(east) < 1)] > 0).all()
