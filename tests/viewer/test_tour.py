"""Tours that branch: links in both directions, crossings, map, names and hotspots; and the module in other pages."""

import json
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from interpolation_samples import tour_job
from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view, run_view
from synthesis_samples import posed, write_hall
from viewer.browser import WalkPage, serving

# x and z of nine panoramas: a street with two crossings, at p1 and p3.
PLACES = {
    "p0": (-1.2, 0.0), "p1": (-0.6, 0.0), "p2": (0.0, 0.0), "p3": (0.6, 0.0), "p4": (1.2, 0.0),
    "p5": (-0.6, -0.7), "p6": (-0.6, 0.7), "p7": (0.6, -0.7), "p8": (0.6, 0.7),
}  # fmt: skip
LINKS = ["p0 p1", "p1 p2", "p1 p5", "p1 p6", "p2 p3", "p3 p4", "p3 p7", "p3 p8"]
DOCUMENT = {
    "version": 1,
    "title": "Nine <i>places</i>",
    "start": {"panorama": "p2.png", "yaw": 0, "fov": 70},
    "panoramas": {
        "p1.png": {"title": "West <b>crossing</b>", "caption": "Three ways out."},
        "p2.png": {
            "title": "Middle",
            "hotspots": [{"text": "Own <img src=x>", "yaw": 10, "pitch": 5, "link": "https://example.org/?a=1&b=2"}],
        },
    },
    "hotspots": [
        {"text": "Before the wall", "point": [0.5, 0.3, -2], "image": "plan.png"},
        {"text": "Behind the wall", "point": [-0.5, 0.3, -6]},
    ],
    "plan": {
        "image": "plan.png",
        "points": [{"pixel": [20, 40], "panorama": "p0.png"}, {"pixel": [100, 40], "panorama": "p4.png"}],
    },
}


def write_tour(folder: Path) -> list[Path]:
    poses = [posed((x, 0.0, z), 0.3 * k) for k, (x, z) in enumerate(PLACES.values())]
    images = write_hall(folder, poses)
    cv2.imwrite(str(folder / "plan.png"), np.full((80, 120, 3), 200, np.uint8))
    (folder / "tour.json").write_text(json.dumps(DOCUMENT))
    return images


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("tour")
    options = {"is_chain": False, "tour": place / "tour.json", "is_folder": True}
    plan = plan_view(tour_job(ViewJob, place, write_tour(place), "walk", **options))
    assert [" ".join(name.removesuffix(".png") for name in link) for link in plan.tour.links] == LINKS
    run_view(plan)
    return place / "walk"


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    with serving(folder) as place:
        yield place


@pytest.fixture
def walk(opened: Any, address: str) -> Iterator[WalkPage]:
    page = WalkPage(opened, address, has_touch=True, viewport={"width": 640, "height": 400}).wait()
    yield page
    assert page.errors == []
    assert all(request.startswith((address, "blob:")) for request in page.requests)
    page.page.context.close()


def here(walk: WalkPage) -> str | None:
    return walk.page.evaluate("omnisyn.page.world.panoramas[omnisyn.page.walker.panorama]?.name.slice(0, 2) ?? null")


def stand(walk: WalkPage, name: str, yaw: float, pitch: float = 0.0) -> None:
    """At a panorama, looking at degrees to the right of −z."""
    walk.page.evaluate(f"location.hash = '#at={name}.png&yaw={yaw}&pitch={pitch}&fov=70'")
    walk.until(f"omnisyn.page.world.panoramas[omnisyn.page.walker.panorama].name === '{name}.png'")
    walk.until("document.body.dataset.state === 'ready' && omnisyn.page.drawn !== undefined && !omnisyn.page.isWaiting")


def test_every_link_is_walked_in_both_directions_with_its_heading_kept(walk: WalkPage) -> None:
    """Looking 20 degrees off the way, which decides at the crossings; from end to end in steps of 0.1 m."""
    walk.page.mouse.move(320, 200)
    for link in LINKS:
        for first, second in (link.split(), link.split()[::-1]):
            x, z = np.subtract(PLACES[second], PLACES[first])
            yaw = float(np.degrees(np.arctan2(x, -z))) + 20
            stand(walk, first, yaw)
            for _ in range(round(np.hypot(x, z) / 0.1)):
                walk.page.mouse.wheel(0, -50)
            walk.until(f"omnisyn.page.walker.panorama === {second[1]}")
            turned = np.degrees(walk.walker("yaw")) - yaw
            assert abs((turned + 180) % 360 - 180) < 1e-6


def test_the_wheel_and_a_click_take_the_way_that_is_looked_at(walk: WalkPage) -> None:
    walk.page.mouse.move(320, 200)
    for yaw, expected in ((0, "p5"), (90, "p2"), (180, "p6"), (-90, "p0")):
        stand(walk, "p1", yaw, -88)
        walk.page.mouse.wheel(0, -100)
        walk.until("omnisyn.page.walker.panorama === null")
        assert walk.page.evaluate("omnisyn.page.walker.link.ends").count(int(expected[1])) == 1
        stand(walk, "p1", yaw, 20)
        walk.page.mouse.click(320, 200)
        walk.until("omnisyn.page.walker.goal === null && omnisyn.page.walker.panorama !== 1")
        assert here(walk) == expected


def test_the_map_shows_and_leads(walk: WalkPage) -> None:
    """By mouse, by touch and by keys; from one end of the tour to another over both crossings."""
    assert walk.page.is_visible("#map")
    walk.page.wait_for_selector("#floor:not([hidden])")
    dots = walk.page.locator(".dot")
    assert [dots.nth(k).get_attribute("aria-label") for k in (1, 2, 3)] == [
        "Go to West <b>crossing</b>", "Go to Middle", "Go to p3",
    ]  # fmt: skip
    boxes = [dots.nth(k).bounding_box() for k in range(9)]
    centres = np.array([[box["x"] + box["width"] / 2, box["y"] + box["height"] / 2] for box in boxes if box])
    scale = (centres[4] - centres[0])[0] / 2.4
    np.testing.assert_allclose(
        (centres - centres[0]) / scale, np.array(list(PLACES.values())) - PLACES["p0"], atol=0.02
    )
    floor = walk.page.locator("#floor").bounding_box()
    np.testing.assert_allclose(centres[[0, 4], 0] - floor["x"], np.array([20, 100]) * floor["width"] / 120, atol=1)
    for index, go in ((5, dots.nth(5).click), (8, dots.nth(8).tap), (0, lambda: dots.nth(0).press("Enter"))):
        go()
        walk.until(f"omnisyn.page.walker.panorama === {index} && omnisyn.page.walker.goal === null")
        assert dots.nth(index).get_attribute("aria-current") == "location"
    walk.page.keyboard.press("m")
    assert not walk.page.is_visible("#map")


def test_titles_and_captions_are_text(walk: WalkPage) -> None:
    stand(walk, "p1", 0)
    walk.until("omnisyn.page.$('title').textContent === 'West <b>crossing</b>'")
    assert walk.page.text_content("#caption") == "Three ways out."
    assert walk.page.locator("#where b b").count() == 0
    assert walk.page.title() == "Nine <i>places</i>"


def test_hotspots_are_hidden_by_what_stands_before_them_and_open(walk: WalkPage) -> None:
    stand(walk, "p2", 0)
    marks = {name: walk.page.locator(f".mark[title='{name}']") for name in ("Before the wall", "Behind the wall")}
    walk.until("!omnisyn.page.hotspots.marks[1].button.hidden")
    assert marks["Before the wall"].is_visible()
    assert not marks["Behind the wall"].is_visible()
    box = marks["Before the wall"].bounding_box()
    walk.page.mouse.click(box["x"] + 13, box["y"] + 13)
    assert walk.page.text_content("#card-title") == "Before the wall"
    walk.page.wait_for_selector("#card-picture:not([hidden])")
    walk.page.keyboard.press("Escape")
    assert not walk.page.is_visible("#card")
    walk.page.touchscreen.tap(box["x"] + 13, box["y"] + 13)
    assert walk.page.is_visible("#card")
    walk.page.click("#card-close")


def test_the_card_shows_the_picture_of_the_hotspot_that_was_opened_last(walk: WalkPage) -> None:
    """However late that of the one before comes."""
    shown = walk.page.evaluate("""async () => {
        const { hotspots, world } = omnisyn.page, { button, spot } = hotspots.marks[1];
        const address = world.blocks.address.bind(world.blocks);
        let late;
        world.blocks.address = (image) => new Promise((done) => { late = () => done(address(image)); });
        const first = hotspots.open(spot, button);
        world.blocks.address = address;
        await hotspots.open({ text: 'Last', link: null, image: null }, button);
        late();
        await first;
        return [hotspots.title.textContent, hotspots.picture.hidden];
    }""")
    assert shown == ["Last", True]


def test_an_own_hotspot_lies_on_the_surface_where_it_was_placed(walk: WalkPage) -> None:
    """10 degrees to the right in the picture of p2, which is turned by 0.6 radians; a key opens it."""
    own = "omnisyn.page.hotspots.marks[0]"
    x, y, z, w = walk.page.evaluate(f"{own}.spot.place")
    heading = 0.6 if posed((0, 0, 0), 0.6).rotation[0, 2] < 0 else -0.6
    assert np.degrees(np.arctan2(x, -z) - heading) == pytest.approx(10, abs=0.1)
    assert (np.linalg.norm([x, y, z]) > 2, w) == (True, 1.0)
    stand(walk, "p2", np.degrees(heading) + 10)
    walk.until(f"!{own}.button.hidden")
    mark = walk.page.locator(".mark").first
    mark.focus()
    walk.page.keyboard.press("Enter")
    link = walk.page.locator("#card-link")
    assert link.get_attribute("href") == "https://example.org/?a=1&b=2"
    assert link.get_attribute("rel") == "noopener noreferrer"
    assert walk.page.text_content("#card-title") == "Own <img src=x>"
    stand(walk, "p4", np.degrees(heading) + 10)
    assert not mark.is_visible()


def test_playing_goes_through_all_panoramas(walk: WalkPage) -> None:
    walk.page.evaluate("""() => {
        window.seen = new Set();
        omnisyn.page.addEventListener('arrive', (event) => window.seen.add(event.detail));
        omnisyn.page.togglePlay();
    }""")
    walk.until("!omnisyn.page.walker.isPlaying")
    assert walk.page.evaluate("window.seen.size") == 9


def test_the_address_keeps_a_place_on_a_link(opened: Any, address: str) -> None:
    page = WalkPage(opened, address, "#from=p1.png&to=p6.png&t=0.25&yaw=30&pitch=-10&fov=60").wait()
    assert page.page.evaluate("omnisyn.page.place.to") == "p6.png"
    assert page.walker("t") == 0.25
    page.until("location.hash.startsWith('#from=p1.png&to=p6.png&t=0.250&yaw=30.0')")
    page.page.context.close()


def test_what_lies_far_away_is_dropped(walk: WalkPage) -> None:
    """Without a budget for more, the link at hand is all that is kept, wherever one has been."""
    walk.page.evaluate("omnisyn.page.world.budget = 0")
    kept = set()
    for name in (*PLACES, *reversed(PLACES)):
        stand(walk, name, 0)
        walk.until("omnisyn.page.world.isReady(omnisyn.page.walker.link) && omnisyn.page.world.pending.size === 0")
        kept.add(walk.page.evaluate("omnisyn.page.world.things.size"))
        assert walk.page.evaluate("omnisyn.page.graphicsBytes") < 30e6
    assert max(kept) <= 7


EMBEDDING = """<!DOCTYPE html><html><body><h1>Mine</h1>
<div id="box" style="position: absolute; left: 40px; top: 60px; width: 400px; height: 240px"></div>
<script type="module">
import { OmnisynWalk } from './walk/omnisyn-walk.js';
window.events = [];
const walk = window.walk = new OmnisynWalk(document.getElementById('box'), 'walk/walk.json', { hasControls: false });
for (const kind of ['ready', 'arrive', 'move', 'hotspot', 'error'])
  walk.addEventListener(kind, (event) => window.events.push([kind, event.detail]));
</script></body></html>"""


def embedded(opened: Any, folder: Path, broken: Collection[str] = ()) -> Any:
    """The page of somebody else with the walk in it."""
    page = opened.new_context(viewport={"width": 640, "height": 400}).new_page()
    page.route("**/*", lambda route: answer(route, folder, broken))
    page.goto("http://127.0.0.1/mine.html")
    return page


def test_the_module_runs_in_a_page_of_others(opened: Any, folder: Path) -> None:
    """By its documented interface, without a word of our page."""
    page = embedded(opened, folder)
    page.evaluate("walk.ready")
    assert page.evaluate("walk.panoramas.length + walk.links.length") == 17
    assert page.evaluate("walk.panoramas[1].title") == "West <b>crossing</b>"
    assert not page.is_visible("#bar")
    assert page.evaluate("walk.goTo('p7.png')") is True
    place = page.evaluate("walk.place")
    assert place["nearest"] == "p7.png"
    page.evaluate("walk.lookAt({ yaw: 45, pitch: 10, fov: 60 })")
    assert page.evaluate("[walk.place.yaw, walk.place.pitch, walk.place.fov].map(Math.round)") == [45, 10, 60]
    page.evaluate("walk.goTo('p2.png', { isSudden: true })")
    page.evaluate("walk.lookAt({ point: [0, 0, -1] })")
    assert page.evaluate("Math.round(walk.place.yaw)") == 0
    kinds = {kind for kind, _ in page.evaluate("window.events")}
    assert kinds == {"ready", "arrive", "move"}
    page.keyboard.press("ArrowUp")
    assert page.evaluate("walk.walker.t") in (0, 1)
    assert page.evaluate("location.hash") == ""
    assert page.evaluate("walk.graphicsBytes") > 0
    page.context.close()


AGAIN = """() => {
  walk.dispose();
  window.again = new walk.constructor(document.getElementById('box'), 'walk/walk.json');
  return again.ready;
}"""


def test_after_its_end_nothing_of_a_walk_is_left(opened: Any, folder: Path) -> None:
    """Ended while it opens, then while it is shown; the next walk in the same element works."""
    page, errors = embedded(opened, folder), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.wait_for_function("window.walk")
    assert page.evaluate("walk.dispose(), walk.ready.catch((error) => error.name)") == "AbortError"
    page.evaluate(AGAIN)
    second = "new walk.constructor(again.element, 'walk/walk.json')"
    assert "dispose of the walk in it" in page.evaluate(
        f"(() => {{ try {{ {second} }} catch (error) {{ return error.message }} }})()"
    )
    assert page.evaluate("again.goTo('p7.png')") is True
    arrival = "[again.goTo('p2.png'), again.dispose()][0]"
    assert page.evaluate(arrival) is False
    page.evaluate("""() => {
        Object.assign(again.element.style, { width: '300px' });
        again.element.dispatchEvent(new KeyboardEvent('keydown', { code: 'ArrowUp' }));
        window.dispatchEvent(new Event('blur'));
    }""")
    page.wait_for_timeout(500)
    assert page.evaluate("[again.world.things.size, again.controls.held.size, again.isWaiting]") == [0, 0, False]
    assert page.evaluate("[again.root.childNodes.length, Object.keys(again.element.dataset).length]") == [0, 0]
    page.evaluate("window.walk = again")
    page.evaluate(AGAIN)
    assert page.evaluate("again.goTo('p1.png')") is True
    assert errors == []
    page.context.close()


def test_what_does_not_come_is_asked_for_again(opened: Any, folder: Path) -> None:
    """Panoramas that are fetched ahead say nothing; those that are needed say so, and the walk goes on."""
    broken: list[str] = []
    page = embedded(opened, folder, broken)
    page.evaluate("walk.ready")
    page.evaluate("walk.goTo('p2.png', { isSudden: true })")
    page.wait_for_function("walk.world.pending.size === 0")
    far = ["p7.png", "p8.png"]
    levels = (
        "walk.manifest.panoramas.find((one) => one.name === name).photo.map(({ block }) => walk.manifest.files[block])"
    )
    broken += page.evaluate(f"(names) => names.flatMap((name) => {levels})", far)
    page.evaluate("walk.goTo('p3.png', { isSudden: true })")
    page.wait_for_function("walk.place.nearest === 'p3.png' && walk.element.dataset.state === 'ready'")
    page.wait_for_timeout(500)
    assert "error" not in {kind for kind, _ in page.evaluate("window.events")}
    page.evaluate("walk.goTo('p7.png', { isSudden: true })")
    page.wait_for_function("window.events.some(([kind]) => kind === 'error')")
    assert "503" in page.text_content("#status")
    broken.clear()
    page.wait_for_function("walk.$('loading').hidden && walk.world.pictureOf(7) !== null")
    assert page.evaluate("walk.goTo('p3.png')") is True
    page.context.close()


def answer(route: Any, folder: Path, broken: Collection[str] = ()) -> None:
    """The page of somebody else, and beside it the folder of the walk, whose server fails for some files."""
    path = route.request.url.partition("127.0.0.1/")[2]
    if path.rpartition("/")[2] in broken:
        route.fulfill(status=503)
        return
    if path == "mine.html":
        route.fulfill(body=EMBEDDING, content_type="text/html")
        return
    file = folder.parent / path
    kind = {".js": "text/javascript", ".json": "application/json"}.get(file.suffix, "application/octet-stream")
    if file.is_file():
        route.fulfill(body=file.read_bytes(), content_type=kind)
    else:
        route.fulfill(status=404)
