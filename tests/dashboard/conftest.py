"""A headless browser for the tests of the page, or a reason why there is none."""

import shutil
from collections.abc import Iterator

import pytest

# WebGL without a graphics card. The page itself is composited without WebGL, in less time.
FLAGS = (
    "--no-sandbox",
    "--disable-gpu-compositing",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
)
HOW = "needs a browser: `make browser` as root on Debian, or `apt-get install chromium`"


def browser_path() -> str | None:
    """The browser that is installed; None where there is none."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="session")
def chromium() -> Iterator:
    """A headless Chromium; skips where there is none."""
    path = browser_path()
    if path is None:
        pytest.skip(HOW)
    playwright_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    with playwright_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*FLAGS])
        yield browser
        browser.close()
