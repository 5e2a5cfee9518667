"""A run of the tests on a machine without a browser."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.dashboard.conftest import HOW

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_last_line_says_that_there_was_no_browser(tmp_path: Path):
    one = "tests/dashboard/test_browser_windows.py::test_the_console_is_clean"
    found = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", one],
        cwd=ROOT, env={**os.environ, "PATH": str(tmp_path)}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    last = found.stdout.strip().splitlines()[-1]
    assert last == f"NO BROWSER: 1 tests of the page were skipped; it {HOW}"
