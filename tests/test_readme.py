"""Every command of README.md runs as it is printed.

Commands are the lines of its ```sh blocks. They run one after the other in a folder that looks like
a checkout with nothing in `runs/` yet, in the project's environment, as a reader would do it.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHARED = "../shared"
# What a reader has done before, and what the tests of the project are run by.
SKIPPED = ("make", "git clone", "cd ", ". .venv")
TIMEOUT_S = 120


def commands(text: str) -> list[str]:
    """The commands of a page, each on one line."""
    found = []
    for block in BLOCK.findall(text):
        for line in block.replace("\\\n", " ").splitlines():
            command = line.partition(" #")[0].strip().removeprefix("$ ")
            if command and not command.startswith(("#", *SKIPPED)):
                found.append(" ".join(command.split()))
    return found


COMMANDS = commands(README.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with links to all that the checkout holds but results, beside the shared data."""
    above = tmp_path_factory.mktemp("readme")
    folder = above / "concord"
    folder.mkdir()
    for entry in ROOT.iterdir():
        if entry.name not in ("runs", ".git"):
            (folder / entry.name).symlink_to(entry)
    if (ROOT / SHARED).is_dir():
        (above / "shared").symlink_to((ROOT / SHARED).resolve())
    return folder


def test_the_readme_has_commands():
    assert COMMANDS, "README.md has no ```sh block: print the commands that a reader should try"


@pytest.mark.zenoh
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_readme_runs(command: str, checkout: Path):
    if SHARED in command and not (ROOT / SHARED).is_dir():
        pytest.skip(f"needs {SHARED}, which is no part of the checkout")
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


def test_how_commands_are_found():
    page = (
        "# x\n\n```sh\nconcord list\n$ concord run --steps 3 \\\n    --seed 2   # short\n"
        "# no command\nmake demo\n```\n\n```python\nprint()\n```\n\n```sh\npython a.py\n```\n"
    )
    assert commands(page) == ["concord list", "concord run --steps 3 --seed 2", "python a.py"]
    assert commands("no commands here") == []


def test_pages_that_the_readme_names_exist():
    text = README.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", text):
        assert (ROOT / target).exists(), f"README.md links to {target}, which is not there"
