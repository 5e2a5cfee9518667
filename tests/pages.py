"""Commands of a page for users, run as a reader would run them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
# Recorded data, no part of the checkout; pages say `data/...` for wherever a reader keeps it.
DATA = ROOT.parent / "shared" / "data"
# Commands that a reader has already run, and the `make` targets that run the tests.
SKIPPED = ("make", "git clone", "cd ", ". .venv")
# Only a command that hangs takes so long, on a loaded machine too.
TIMEOUT_S = 1800


def blocks(text: str, language: str) -> list[str]:
    """Return the code blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def commands(text: str) -> list[str]:
    """The commands of a page's ```sh blocks, each on one line."""
    found = []
    for block in blocks(text, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            command = line.partition(" #")[0].strip().removeprefix("$ ")
            if command and not command.startswith(("#", *SKIPPED)):
                found.append(" ".join(command.split()))
    return found


def link_checkout(above: Path) -> Path:
    """A folder below `above` with links to all that the checkout holds but results, and to recorded
    data."""
    folder = above / "concord"
    folder.mkdir()
    for entry in ROOT.iterdir():
        if entry.name not in ("runs", ".git"):
            (folder / entry.name).symlink_to(entry)
    if DATA.is_dir():
        (folder / "data").symlink_to(DATA)
    return folder


def run_as_reader(command: str, checkout: Path) -> str:
    """Run a command in the project's environment; return its output. Fails unless it succeeds."""
    if re.search("[ :]data/", command) and not DATA.is_dir():
        pytest.skip("needs recorded data in ../shared/data, which is no part of the checkout")
    binaries = Path(sys.executable).parent
    done = subprocess.run(
        command,
        shell=True,
        cwd=checkout,
        env={**os.environ, "PATH": f"{binaries}{os.pathsep}{os.environ['PATH']}"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    return done.stdout
