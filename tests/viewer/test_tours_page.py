"""``docs/tours.md`` as a newcomer follows it: every command runs, and its example of a ``tour.json`` is one."""

import json
import os
import re
import shlex
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import Omnisyn
from omnisyn_cli.io import write_image
from viewer.browser import MINUTES, Launch

PAGE = Path(__file__).parents[2] / "docs" / "tours.md"

PICTURES = ("corridor.jpg", "kitchen.jpg", "office.jpg")

MOST_COMMANDS = 10

ENVIRONMENT = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)


@contextmanager
def running(command: str, folder: Path, port: int) -> Iterator[None]:
    """A server, until it is no longer needed."""
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
    kind = ("--kind", "home", "--seed", 3, "--frames", 3, "--baseline", 2.4, "--size", "1024x512", "--no-depth")
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
