"""One driver of browsers for all tests of walks that a process runs."""

from collections.abc import Iterator

import pytest

from viewer.browser import Launch, launcher


@pytest.fixture(scope="session")
def launch() -> Iterator[Launch]:
    """Opens browsers; skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright, which the extra 'test' brings")
    with playwright.sync_playwright() as driver:
        yield launcher(driver)
