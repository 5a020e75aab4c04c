"""A real browser for pages that walks are, headless, with WebGL in software; tests skip where there is none."""

import base64
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import cv2
import numpy as np
import pytest

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.interpolation.viewer.serve import served

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
SOFTWARE_GL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
QUIET = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync",
)  # fmt: skip

MINUTES = 120_000  # Milliseconds: busy machines draw slowly.
FACES = ((0, 0), (90, 0), (180, 0), (270, 0), (0, 90), (0, -90))  # Degrees to the right and upwards.
CAPTURE = """async ([pose, fov, size]) => {
  const picture = await omnisyn.capture(pose, fov, size);
  const text = (values) => {
    const bytes = new Uint8Array(values.buffer);
    let all = '';
    for (let k = 0; k < bytes.length; k += 32768) all += String.fromCharCode(...bytes.subarray(k, k + 32768));
    return btoa(all);
  };
  return [text(picture.colours), ...picture.inverseDepth.map((values) => text(values ?? new Float32Array()))];
}"""


Launch = Callable[..., AbstractContextManager[Any]]  # Opens a browser with switches; by default with WebGL in software.


def launcher(driver: Any) -> Launch:
    """What opens browsers of this machine; skips where there is none."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip(f"needs a browser, one of {', '.join(PROGRAMS)}")

    @contextmanager
    def launch(*switches: str) -> Iterator[Any]:
        opened = driver.chromium.launch(executable_path=program, args=[*QUIET, *(switches or SOFTWARE_GL)])
        try:
            yield opened
        finally:
            opened.close()

    return launch


class WalkPage:
    """A walk in a browser: Playwright's page, addresses that were asked for, what went wrong in scripts."""

    def __init__(self, opened: Any, address: Path | str, place: str = "", **context: Any) -> None:
        self.page = opened.new_context(**{"viewport": {"width": 320, "height": 200}, **context}).new_page()
        self.page.set_default_timeout(MINUTES)
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda message: message.type == "error" and self.errors.append(message.text))
        self.page.goto((address.as_uri() if isinstance(address, Path) else address) + place)

    def wait(self, state: str = "ready") -> "WalkPage":
        """Until all is unpacked, or failed."""
        self.page.wait_for_selector(f"body[data-state={state}]")
        return self

    def walker(self, name: str) -> Any:
        """One of the walker's numbers."""
        return self.page.evaluate(f"omnisyn.page.walker.{name}")

    def until(self, condition: str) -> None:
        """Wait for an expression; the page's own policy forbids Playwright's way, which evaluates text in the page."""
        for _ in range(MINUTES // 50):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"expected {condition}")

    def capture(
        self, rotation: np.ndarray, position: np.ndarray, fov: float, size: tuple[int, int]
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Colours ``(height, width, 3)`` of 8 bits, and inverse depths of both surfaces; degrees from top to bottom."""
        pose = {"position": position.tolist(), "rotation": rotation.ravel().tolist()}
        height, width = size
        colours, *depths = (
            base64.b64decode(text) for text in self.page.evaluate(CAPTURE, [pose, fov, [width, height]])
        )
        return (
            np.frombuffer(colours, np.uint8).reshape(height, width, 4)[..., :3],
            [np.frombuffer(depth, np.float32).reshape(height, width) for depth in depths if depth],
        )

    def unfolded(self, pose: Pose, size: tuple[int, int]) -> np.ndarray:
        """Six captured faces put together to a panorama, ``(height, width, 3)`` in [0, 1]."""
        directions, nearest, side = pixel_directions(*size), np.full(size, -1.0), 2 * size[0]
        panorama = np.zeros((*size, 3), np.float32)
        for yaw, pitch in FACES:
            turn = look(yaw, pitch)
            colours, _ = self.capture(pose.rotation @ turn, pose.position, 90, (side, side))
            x, y, z = np.moveaxis(directions @ turn, -1, 0)
            ahead = np.maximum(-z, 1e-9)
            place = ((x / ahead + 1) * side / 2 - 0.5, (1 - y / ahead) * side / 2 - 0.5)
            col, row = (axis.astype(np.float32) for axis in place)
            face = cv2.remap(colours.astype(np.float32) / 255, col, row, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
            here = -z > nearest
            panorama[here], nearest[here] = face[here], -z[here]
        return panorama


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """The address of a folder that is served meanwhile."""
    with served(folder) as (address, server):
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield address
        finally:
            server.shutdown()
            thread.join()


def pinhole_rays(size: tuple[int, int], fov: float) -> np.ndarray:
    """Unit vectors ``(height, width, 3)`` through the pixels of a pinhole camera, in its own frame."""
    height, width = size
    reach = np.tan(np.radians(fov) / 2)
    y = reach * (1 - (np.arange(height) + 0.5) * 2 / height)
    x = reach * width / height * ((np.arange(width) + 0.5) * 2 / width - 1)
    rays = np.stack([*np.meshgrid(x, y), np.full(size, -1.0)], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def look(yaw: float, pitch: float) -> np.ndarray:
    """The rotation of an eye turned to the right of −z and upwards, in degrees."""
    (sy, sp), (cy, cp) = np.sin(np.radians([yaw, pitch])), np.cos(np.radians([yaw, pitch]))
    return np.array([[cy, -sy * sp, -sy * cp], [0, cp, -sp], [sy, cy * sp, cy * cp]])
