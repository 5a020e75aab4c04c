"""One driver of browsers for all tests of walks that a process runs."""

import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from viewer.browser import Launch, launcher


@pytest.fixture(scope="session")
def launch() -> Iterator[Launch]:
    """Opens browsers; skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright, which the extra 'test' brings")
    with playwright.sync_playwright() as driver:
        yield launcher(driver)


@pytest.fixture(scope="module")
def opened(launch: Launch) -> Iterator[Any]:
    """A browser with WebGL in software."""
    with launch() as browser:
        yield browser


@pytest.fixture(scope="session")
def npm() -> str:
    """The program that gets viewers of others; skips where there is none, or no registry."""
    program = shutil.which("npm")
    if program is None:
        pytest.skip("needs npm")
    asked = [program, "ping", "--fetch-retries=0", "--fetch-timeout=20000"]
    if subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("needs npm's registry, which does not answer")
    return program
