"""Sites in the viewers themselves, which npm gets: the same landmark after every link; docs/tours.md as written."""

import functools
import http.server
import io
import json
import os
import re
import shlex
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cli.cli_samples import Omnisyn
from export.site_samples import LANDMARKS, LINKS, NEIGHBOUR, PLACES, pose_of, write_tour
from omnisyn_cli.interpolation.export.viewers import VIEWERS
from omnisyn_cli.io import write_image
from viewer.browser import MINUTES, Launch

WIDTH, HEIGHT = 720, 400
TOLERANCE_DEG = 0.5
PANNELLUM_LINK = (
    "(id) => viewer.getConfig().hotSpots.find((spot) => (spot.sceneId ?? spot.clickHandlerArgs?.target) === id)"
)

# What every viewer calls what is done here.
JAVASCRIPT = {
    "pannellum": {
        "ready": "typeof viewer !== 'undefined' && viewer && viewer.isLoaded()"
        " && !document.querySelector('.pnlm-fade-img')",
        "scene": "viewer.getScene()",
        "turn": "([yaw, pitch]) => viewer.lookAt(pitch, yaw, undefined, false)",
        "view": "[viewer.getYaw(), viewer.getPitch()]",
        "across": "viewer.getHfov()",
        "link": f"{PANNELLUM_LINK}.div",
        "follow": f"{PANNELLUM_LINK}.div.click()",
        "marks": ".pnlm-hotspot-base",
        "texts": "[...document.querySelectorAll('.pnlm-tooltip span')].map((mark) => mark.textContent)",
    },
    "photo-sphere-viewer": {
        "ready": "window.viewer?.state.ready && !viewer.state.transitionAnimation && !viewer.state.loadingPromise"
        " && !viewer.getPlugin('virtual-tour').state.loadingNode"
        " && getComputedStyle(document.querySelector('.psv-canvas-container')).opacity === '1'",
        "scene": "viewer.getPlugin('virtual-tour').getCurrentNode().id",
        "turn": "([yaw, pitch]) => viewer.rotate({ yaw: yaw * Math.PI / 180, pitch: pitch * Math.PI / 180 })",
        "view": "Object.values(viewer.getPosition()).map((angle) => angle * 180 / Math.PI)",
        "across": "viewer.state.hFov",
        "link": "(id) => [...document.querySelectorAll('.psv-virtual-tour-link')]"
        ".find((a) => a.tourLink.nodeId === id)",
        "follow": "(id) => { const tour = viewer.getPlugin('virtual-tour');"
        " tour.setCurrentNode(id, null, tour.getCurrentNode().links.find((link) => link.nodeId === id)); }",
        "marks": ".psv-virtual-tour-link, .psv-marker",
        "texts": "viewer.getPlugin('markers').getMarkers().map((mark) => mark.config.tooltip.content)",
    },
    "marzipano": {
        "ready": "typeof viewer !== 'undefined' && viewer?.scene() && !viewer._replacedScene",
        "scene": "[...scenes].find(([, { scene }]) => scene === viewer.scene())?.[0]",
        "turn": "([yaw, pitch]) => viewer.scene().view()"
        ".setParameters({ yaw: yaw * Math.PI / 180, pitch: -pitch * Math.PI / 180 })",
        "view": "[viewer.scene().view().yaw(), -viewer.scene().view().pitch()].map((angle) => angle * 180 / Math.PI)",
        "across": "2 * Math.atan(innerWidth / innerHeight * Math.tan(viewer.scene().view().fov() / 2)) * 180 / Math.PI",
        "link": "(id) => viewer.scene().hotspotContainer().listHotspots().map((spot) => spot.domElement().firstChild)"
        ".find((mark) => mark.textContent === scenes.get(id).data.name)",
        "follow": "(id) => viewer.scene().hotspotContainer().listHotspots().map((spot) => spot.domElement().firstChild)"
        ".find((mark) => mark.textContent === scenes.get(id).data.name).click()",
        "marks": ".mark",
        "texts": "[...document.querySelectorAll('.mark')].map((mark) => mark.textContent)",
    },
}


KEEP_VIDEOS = """
  window.videos = [];
  const make = document.createElement.bind(document);
  document.createElement = (name, ...more) => {
    const element = make(name, ...more);
    if (name === 'video') videos.push(element);
    return element;
  };
"""


@contextmanager
def served(folder: Path) -> Iterator[str]:
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever).start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Nothing."""


@dataclass
class Shown:
    page: Any
    script: dict[str, str]
    requests: list[str]
    errors: list[str]

    def wait(self) -> None:
        for _ in range(MINUTES // 50):
            if self.page.evaluate(self.script["ready"]):
                self.page.wait_for_timeout(100)  # the next frame shows it
                return
            self.page.wait_for_timeout(50)
        raise AssertionError("expected a panorama")

    def do(self, what: str, *given: Any) -> Any:
        return self.page.evaluate(self.script[what], *given)

    def turn(self, yaw: float, pitch: float) -> None:
        self.do("turn", [yaw, pitch])
        self.page.wait_for_timeout(150)

    def off_centre(self, colour: tuple[int, int, int]) -> float:
        """Degrees between the centre of the picture and that of what has a colour."""
        hide = self.page.add_style_tag(content=f"{self.script['marks']} {{ visibility: hidden !important }}")
        for _ in range(MINUTES // 200):
            shot = np.asarray(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")).astype(int)
            is_it = np.abs(shot - colour).max(axis=-1) < 60
            if is_it.sum() > 50:
                break
            self.page.wait_for_timeout(200)
        else:
            raise AssertionError(f"expected {colour} in the picture")
        hide.evaluate("(style) => style.remove()")
        row, col = (float(index.mean()) + 0.5 for index in np.nonzero(is_it))
        return self.degrees_off(col, row)

    def degrees_off(self, x: float, y: float) -> float:
        focal = WIDTH / 2 / np.tan(np.radians(self.do("across")) / 2)
        return float(np.degrees(np.arctan(np.hypot(x - WIDTH / 2, y - HEIGHT / 2) / focal)))

    def arrive(self, scene: str) -> None:
        for _ in range(MINUTES // 50):
            if self.do("scene") == scene:
                return self.wait()
            self.page.wait_for_timeout(50)
        raise AssertionError(f"expected {scene}, got {self.do('scene')}")


@contextmanager
def opened_site(viewer: str, npm: str, browser: Any, folder: Path, omnisyn: Omnisyn, *more: object) -> Iterator[Shown]:
    """The painted tour as a site, with the viewer that the program says how to get; nothing comes from elsewhere."""
    site = folder / "a site"
    said = omnisyn.made("export", write_tour(folder / "tour"), "--format", viewer, "-o", site, *more).err
    command = next(line for line in said.splitlines() if "npm install" in line).split("get it: ")[1]
    subprocess.run([npm, *shlex.split(command)[1:]], check=True, capture_output=True)
    with served(site) as address:
        page = browser.new_context(viewport={"width": WIDTH, "height": HEIGHT}).new_page()
        page.set_default_timeout(MINUTES)
        page.add_init_script(KEEP_VIDEOS)
        found = Shown(page, JAVASCRIPT[viewer], [], [])
        page.on("request", lambda each: found.requests.append(each.url))
        page.on("pageerror", lambda error: found.errors.append(str(error)))
        page.on("console", lambda each: each.type == "error" and found.errors.append(each.text))
        page.goto(address)
        found.wait()
        yield found
        assert found.errors == []
        assert [url for url in found.requests if not url.startswith((address, "data:", "blob:"))] == []
        page.context.close()


@pytest.fixture(params=sorted(JAVASCRIPT))
def shown(request: pytest.FixtureRequest, npm: str, opened: Any, tmp_path: Path, omnisyn: Omnisyn) -> Iterator[Shown]:
    with opened_site(request.param, npm, opened, tmp_path, omnisyn) as site:
        yield site


def identity(name: str) -> str:
    index = list(PLACES).index(name)
    return f"{index:04d}_" + "".join(letter if letter.isalnum() else "_" for letter in name)


def yaw_and_pitch(direction: np.ndarray) -> tuple[float, float]:
    x, y, z = direction
    return float(np.degrees(np.arctan2(x, -z))), float(np.degrees(np.arctan2(y, np.hypot(x, z))))


def test_after_every_link_the_same_landmark_is_in_the_centre(shown: Shown) -> None:
    colour, place = LANDMARKS["red"]
    assert shown.off_centre(colour) < TOLERANCE_DEG  # the start view
    off = []
    ways = [way for there in LINKS for way in (there, there[::-1])]
    for index, (here, there) in enumerate(ways):
        towards = yaw_and_pitch(pose_of(there).position - pose_of(here).position)
        shown.turn(*towards)
        off.append(shown.off_centre(NEIGHBOUR))
        box = shown.page.evaluate_handle(shown.script["link"], identity(there)).bounding_box()
        off.append(shown.degrees_off(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2))
        colour, place = list(LANDMARKS.values())[index % len(LANDMARKS)]
        shown.turn(*place)
        off.append(shown.off_centre(colour))
        before = shown.do("view")
        shown.do("follow", identity(there))
        shown.arrive(identity(there))
        off.append(shown.off_centre(colour))
        turned = (np.subtract(shown.do("view"), before) + 180) % 360 - 180
        assert np.abs(turned).max() < 0.01
    print(f"degrees off the centre: greatest {max(off):.3f}, mean {np.mean(off):.3f} of {len(off)}")
    assert max(off) < TOLERANCE_DEG


def test_a_link_is_followed_by_hand_and_texts_are_texts(shown: Shown) -> None:
    texts = shown.do("texts")
    assert any("thing" in text for text in texts)
    assert shown.page.evaluate("document.querySelectorAll('i, #panorama script').length") == 0
    assert "<b>rebuilt</b>" in shown.page.inner_text("body")
    assert shown.page.title() == "A tour <script>alert(1)</script>"
    shown.turn(*yaw_and_pitch(pose_of("stairs").position - pose_of("hall").position))
    shown.page.mouse.click(WIDTH / 2, HEIGHT / 2)
    shown.arrive(identity("stairs"))


@pytest.mark.parametrize("viewer", [name for name in JAVASCRIPT if VIEWERS[name].plays_clips])
def test_a_clip_leads_to_the_next_panorama(viewer, npm, opened, tmp_path, omnisyn) -> None:
    """Half way the landmark is still in the centre, and the picture is that of neither end."""
    options = ("--clips", "--preset", "fast", "--texture", 512, "--threads", 1)
    with opened_site(viewer, npm, opened, tmp_path, omnisyn, *options) as shown:
        colour, place = LANDMARKS["red"]
        shown.turn(*place)
        before = shown.page.screenshot()
        shown.do("follow", identity("garden"))
        for _ in range(MINUTES // 20):
            if shown.page.evaluate("videos.some((video) => video.currentTime > 0.5 && (video.pause(), true))"):
                break
            shown.page.wait_for_timeout(20)
        off = shown.off_centre(colour)
        half_way = shown.page.screenshot()
        assert shown.page.evaluate("videos.length") == 1
        assert not shown.page.evaluate("videos[0].ended")
        shown.page.evaluate("() => { videos[0].play(); }")
        shown.arrive(identity("garden"))
        assert len({before, half_way, shown.page.screenshot()}) == 3
        print(f"{off:.3f} degrees off half way, {shown.off_centre(colour):.3f} there")
        assert off < 1.0  # a pixel and a half of the clip: its depth is an estimate
        assert shown.off_centre(colour) < TOLERANCE_DEG


PAGE = Path(__file__).parents[2] / "docs" / "tours.md"
PICTURES = ("corridor.jpg", "kitchen.jpg", "office.jpg")
MOST_COMMANDS = 10
ENVIRONMENT = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)


@contextmanager
def running(command: str, folder: Path, port: int) -> Iterator[None]:
    server = subprocess.Popen(shlex.split(command), cwd=folder, env=ENVIRONMENT, stderr=subprocess.DEVNULL)
    try:
        for _ in range(600):
            with socket.socket() as tried:
                if tried.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert server.poll() is None, f"{command} has ended"
        yield
    finally:
        server.terminate()
        server.wait()


@pytest.mark.usefixtures("npm")
def test_every_command_runs(tmp_path: Path, omnisyn: Omnisyn, launch: Launch) -> None:
    commands = [line for block in blocks("sh") for line in block.splitlines()]
    assert len(commands) <= MOST_COMMANDS
    names = [part for name in PICTURES for part in ("--name", name)]
    kind = ("--kind", "home", "--seed", 7, "--frames", 3, "--baseline", 2.4, "--size", "1024x512", "--no-depth")
    omnisyn.made("scenes", "make", tmp_path / "pictures", *kind, *names)
    (tmp_path / "pictures" / "poses.json").unlink()
    (tmp_path / "pictures" / "marks").mkdir()
    write_image(tmp_path / "pictures" / "marks" / "fuses.jpg", np.full((8, 16, 3), 200, np.uint8))
    for command in commands:
        if "http.server" in command:
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            with running(command.replace("8000", str(port)), tmp_path, port), launch() as browser:
                page = browser.new_page()
                page.goto(f"http://127.0.0.1:{port}")
                page.wait_for_selector(".pnlm-scene", state="attached", timeout=MINUTES)
                assert page.inner_text(".pnlm-title-box").strip() == "corridor"
                page.close()
        else:
            subprocess.run(["bash", "-c", command], cwd=tmp_path, env=ENVIRONMENT, check=True, capture_output=True)
        if command.endswith("-o pictures/poses.json"):
            (tmp_path / "pictures" / "tour.json").write_text(blocks("json")[0], encoding="utf-8")
    site = json.loads((tmp_path / "site" / "tour.json").read_text())
    (kitchen,) = (scene for name, scene in site["scenes"].items() if name.endswith("kitchen"))
    assert (kitchen["title"], kitchen["author"]) == ("Kitchen", "With a view of the yard")
    assert [mark["text"] for mark in kitchen["hotSpots"]] == ["corridor", "Oven", "Fuse box"]
    assert sorted(file.name for file in (tmp_path / "tagged").iterdir()) == sorted(PICTURES)
