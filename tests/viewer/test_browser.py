"""Walking: every way to move moves, the page works without a network, without WebGL, and after a lost context."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interpolation_samples import tour_job
from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view, run_view
from synthesis_samples import posed, write_hall
from viewer.browser import Launch, WalkPage, serving

TOUR = [posed((0.3 * k, 0.05 * (k % 2), 0.2 * k), 0.2 * k) for k in range(5)]


def written(folder: Path, *, is_folder: bool = False) -> Path:
    output = folder / ("walk" if is_folder else "a walk.html")
    run_view(plan_view(tour_job(ViewJob, folder, write_hall(folder, TOUR), output.name, is_folder=is_folder)))
    return output


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("tour"))


@pytest.fixture
def walk(opened: Any, tour: Path) -> Iterator[WalkPage]:
    page = WalkPage(opened, tour, has_touch=True).wait()
    yield page
    assert page.errors == []
    page.page.context.close()


def test_nothing_is_fetched_and_the_first_picture_is_a_panorama(opened: Any, tour: Path) -> None:
    page = WalkPage(opened, tour, offline=True).wait()
    assert page.requests == [tour.as_uri()]
    assert page.errors == []
    assert page.walker("s") == 0
    assert np.ptp(pixels(page)) > 40


def pixels(page: WalkPage) -> np.ndarray:
    """Of the middle of the canvas."""
    found = page.page.evaluate("""() => {
        const page = omnisyn.page;
        page.draw(1);
        const copy = document.createElement('canvas');
        [copy.width, copy.height] = [64, 64];
        const paper = copy.getContext('2d');
        paper.drawImage(page.canvas, 0, 0, 64, 64);
        return Array.from(paper.getImageData(0, 0, 64, 64).data);
    }""")
    return np.array(found, np.uint8).reshape(64, 64, 4)[..., :3]


def test_playing_walks_from_end_to_end(walk: WalkPage) -> None:
    walk.page.click("#play")
    walk.until("omnisyn.page.walker.s >= 4 && !omnisyn.page.walker.isPlaying")
    assert walk.walker("s") == 4
    walk.until("location.hash.includes('t=4.000')")


def test_keys_walk_and_turn(walk: WalkPage) -> None:
    heading = walk.walker("yaw")
    walk.page.keyboard.down("ArrowUp")
    walk.until("omnisyn.page.walker.s > 1.1")
    walk.page.keyboard.up("ArrowUp")
    assert walk.walker("yaw") == heading
    far = walk.walker("s")
    walk.page.keyboard.down("ArrowDown")
    walk.until(f"omnisyn.page.walker.s < {far} - 0.2")
    walk.page.keyboard.up("ArrowDown")
    walk.page.keyboard.down("ArrowRight")
    walk.until(f"omnisyn.page.walker.yaw > {heading} + 0.1")
    walk.page.keyboard.up("ArrowRight")


@pytest.mark.parametrize("meanwhile", ["Control", "Tab"])
def test_keys_that_are_let_go_no_longer_walk(walk: WalkPage, meanwhile: str) -> None:
    """With another key down, or after the focus went to the slider."""
    walk.page.focus("#play")
    walk.page.keyboard.down("KeyW")
    walk.page.keyboard.down(meanwhile)
    walk.page.keyboard.up("KeyW")
    walk.page.keyboard.up(meanwhile)
    assert walk.page.evaluate("omnisyn.page.controls.held.size") == 0


def test_keys_go_aside_and_up_but_not_out_of_reach(walk: WalkPage) -> None:
    for key in ("KeyD", "KeyE"):
        walk.page.keyboard.down(key)
    walk.until("omnisyn.page.walker.strangeness > 0.99")
    for key in ("KeyD", "KeyE"):
        walk.page.keyboard.up(key)
    beside = np.array(walk.walker("beside"))
    assert beside[1] > 0
    assert np.linalg.norm(beside) <= walk.walker("reach") * 1.0001
    assert walk.walker("s") < 1.0


def test_drag_looks_where_the_hand_pulls(walk: WalkPage) -> None:
    yaw, pitch = walk.walker("yaw"), walk.walker("pitch")
    walk.page.mouse.move(160, 60)
    walk.page.mouse.down()
    walk.page.mouse.move(100, 90, steps=4)
    walk.page.mouse.up()
    per_pixel = walk.walker("fov") / 200
    assert walk.walker("yaw") - yaw == pytest.approx(60 * per_pixel)
    assert walk.walker("pitch") - pitch == pytest.approx(30 * per_pixel)


def test_only_the_main_button_walks(walk: WalkPage) -> None:
    walk.page.mouse.click(160, 60, button="right")
    assert walk.walker("goal") is None
    walk.page.mouse.click(160, 60)
    assert walk.walker("goal") is not None or walk.walker("s") > 0


def test_wheel_walks_and_control_wheel_zooms(walk: WalkPage) -> None:
    walk.page.mouse.move(160, 60)
    walk.page.mouse.wheel(0, -200)
    walk.until("omnisyn.page.walker.s > 0.2")
    fov = walk.walker("fov")
    walk.page.keyboard.down("Control")
    walk.page.mouse.wheel(0, -20)
    walk.page.keyboard.up("Control")
    walk.until(f"omnisyn.page.walker.fov < {fov}")


def test_fingers_look_zoom_and_walk(walk: WalkPage) -> None:
    session = walk.page.context.new_cdp_session(walk.page)

    def touch(kind: str, *points: tuple[int, int]) -> None:
        places = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    yaw = walk.walker("yaw")
    touch("touchStart", (160, 60))
    touch("touchMove", (120, 60))
    touch("touchMove", (80, 60))
    touch("touchEnd")
    walk.until(f"omnisyn.page.walker.yaw > {yaw} + 0.2")
    fov = walk.walker("fov")
    touch("touchStart", (140, 60), (180, 60))
    touch("touchMove", (120, 60), (200, 60))
    touch("touchMove", (80, 60), (240, 60))
    touch("touchEnd")
    walk.until(f"omnisyn.page.walker.fov < 0.8 * {fov}")
    assert walk.walker("s") == 0
    walk.page.evaluate("omnisyn.page.walker.yaw = omnisyn.page.walker.yaw = 2.6")
    walk.page.touchscreen.tap(160, 60)
    walk.until("omnisyn.page.walker.goal !== null || omnisyn.page.walker.s > 0")


def test_a_ring_on_the_ground_leads_to_its_panorama(walk: WalkPage) -> None:
    walk.page.evaluate("omnisyn.page.walker.pitch = -0.4; omnisyn.page.change()")
    walk.page.wait_for_selector(".stop:not([hidden])")
    walk.page.locator(".stop:not([hidden])").first.dispatch_event("click")
    walk.until("omnisyn.page.walker.s === 1 && omnisyn.page.walker.goal === null")


def test_a_ring_leads_to_its_panorama_where_the_way_turns_back(opened: Any, tmp_path: Path) -> None:
    hairpin = [posed((0.0, 0.0, 0.0)), posed((0.6, 0.0, 0.0)), posed((0.1, 0.0, 0.3))]
    output = tmp_path / "walk.html"
    run_view(plan_view(tour_job(ViewJob, tmp_path, write_hall(tmp_path, hairpin), output.name)))
    walk = WalkPage(opened, output, "#t=1&yaw=-90&pitch=-25&fov=100").wait()
    walk.page.wait_for_selector(".stop[aria-label*='panorama 1,']")
    ring = walk.page.locator(".stop").first.bounding_box()
    walk.page.mouse.click(ring["x"] + ring["width"] / 2, ring["y"] + ring["height"] / 2)
    walk.until("omnisyn.page.walker.goal === null && omnisyn.page.walker.s !== 1")
    assert walk.walker("s") == 0
    walk.page.context.close()


def test_the_slider_and_its_words_say_where_one_is(walk: WalkPage) -> None:
    walk.page.fill("#place", "2.5")
    walk.until("omnisyn.page.walker.s === 2.5")
    words = "50 % of the way from p2 to p3"
    walk.until(f"omnisyn.page.$('place').getAttribute('aria-valuetext') === '{words}'")


def test_the_address_leads_back_to_the_place(opened: Any, tour: Path) -> None:
    page = WalkPage(opened, tour, "#t=2.25&yaw=30&pitch=-10&fov=60&beside=0.01,0.02,0").wait()
    found = [page.walker(name) for name in ("s", "yaw", "pitch", "fov")]
    np.testing.assert_allclose(found, [2.25, *np.radians([30, -10, 60])])
    page.until("location.hash.includes('beside=0.010,0.020,0.000')")
    odd = WalkPage(opened, tour, "#t=99&yaw=x&fov=1e9&beside=1,2").wait()
    assert (odd.walker("s"), odd.walker("beside")) == (4, [0, 0, 0])
    assert odd.errors == []


def test_a_link_to_the_way_leads_onto_the_way(walk: WalkPage) -> None:
    walk.page.keyboard.press("KeyD")
    walk.until("location.hash.includes('beside')")
    walk.page.click("#play")
    walk.page.evaluate("location.hash = '#t=1&yaw=0&pitch=0&fov=60'")
    walk.until("omnisyn.page.walker.s === 1 && !omnisyn.page.walker.isPlaying")
    assert walk.walker("beside") == [0, 0, 0]


def test_a_lost_context_comes_back(walk: WalkPage) -> None:
    before = pixels(walk)
    walk.page.evaluate("window.loss = omnisyn.page.gl.getExtension('WEBGL_lose_context'); loss.loseContext()")
    walk.until("omnisyn.page.renderer === null")
    assert walk.page.is_visible("#status")
    walk.page.evaluate("loss.restoreContext()")
    walk.until("omnisyn.page.renderer !== null && !omnisyn.page.gl.isContextLost()")
    walk.until("omnisyn.page.world.isReady(omnisyn.page.walker.link) && omnisyn.page.world.pictureOf(0) !== null")
    np.testing.assert_allclose(pixels(walk).astype(float), before, atol=2)


def test_without_webgl_the_panoramas_fade(tour: Path, launch: Launch) -> None:
    with launch("--disable-3d-apis") as opened:
        page = WalkPage(opened, tour).wait()
        assert "cross-faded" in (page.page.text_content("#status") or "")
        first = pixels(page)
        assert np.ptp(first) > 40
        page.page.fill("#place", "4")
        page.until("omnisyn.page.walker.s === 4 && omnisyn.page.world.pictureOf(4) !== null")
        assert np.abs(pixels(page).astype(float) - first).mean() > 3
        assert page.errors == []


def test_who_wants_no_motion_gets_none(opened: Any, tour: Path) -> None:
    page = WalkPage(opened, tour, reduced_motion="reduce").wait()
    page.page.evaluate("omnisyn.page.goTo(3)")
    assert (page.walker("s"), page.walker("goal")) == (3, None)


def test_only_neighbours_stay_unpacked(walk: WalkPage) -> None:
    for link in range(4):
        walk.page.evaluate(f"omnisyn.page.walker.s = {link + 0.4}; omnisyn.page.change()")
        walk.until(f"omnisyn.page.world.isReady(omnisyn.page.world.links[{link}])")
    kept = "[...omnisyn.page.world.things.keys()].sort().join()"
    near = [*(f"mask {k}" for k in (2, 3, 4)), *(f"photo {k} 0" for k in (2, 3, 4))]
    expected = ",".join([*near, *(f"surface {k}" for k in (3, 4, 5))])  # links share one that looks the same
    walk.until(f"{kept} === '{expected}'")


def test_a_served_folder_walks(opened: Any, tmp_path: Path) -> None:
    with serving(written(tmp_path, is_folder=True)) as address:
        page = WalkPage(opened, address).wait()
        assert all(request.startswith(address) for request in page.requests)
        assert page.errors == []


def test_a_folder_without_a_server_says_what_it_needs(opened: Any, tmp_path: Path) -> None:
    page = WalkPage(opened, written(tmp_path, is_folder=True) / "index.html")
    assert "web server" in (page.page.text_content("body > p") or "")
    assert page.page.is_visible("body > p")


def test_a_damaged_page_says_so(opened: Any, tour: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.html"
    broken.write_text(tour.read_text().replace('id="block-2">', 'id="block-2">AAAA'))
    page = WalkPage(opened, broken).wait("failed")
    assert "cannot be shown" in (page.page.text_content("#status") or "")


def test_a_newcomer_is_told_how_until_they_move(walk: WalkPage) -> None:
    assert walk.page.is_visible("#welcome")
    walk.page.keyboard.press("ArrowRight")
    walk.until("omnisyn.page.walker.hasMoved && document.body.dataset.moved === ''")
    assert not walk.page.is_visible("#welcome")
    walk.page.click("#help")
    assert walk.page.is_visible("#hint")


def test_the_hint_fits_a_phone_and_goes_with_escape(walk: WalkPage) -> None:
    for width, height in ((390, 844), (320, 200)):
        walk.page.set_viewport_size({"width": width, "height": height})
        walk.page.click("#help")
        assert walk.page.is_visible("#hint")
        assert not walk.page.is_visible("#welcome")
        box = walk.page.locator("#hint").bounding_box()
        assert box["y"] >= 0
        assert box["width"] > 0.9 * width
        walk.page.keyboard.press("Escape")
        assert not walk.page.is_visible("#hint")
        assert walk.page.get_attribute("#help", "aria-expanded") == "false"


def test_keys_tilt_zoom_and_go_to_the_ends(walk: WalkPage) -> None:
    fov = walk.walker("fov")
    walk.page.keyboard.press("Shift+ArrowUp")
    walk.page.keyboard.press("+")
    assert walk.walker("pitch") > 0.01
    assert walk.walker("fov") < fov
    assert walk.walker("s") == 0
    walk.page.keyboard.press("End")
    walk.until("omnisyn.page.walker.s === 4")
    walk.page.keyboard.press("?")
    assert walk.page.is_visible("#hint")
