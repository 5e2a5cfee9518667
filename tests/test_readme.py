"""Every command of README.md and of most pages runs as it is printed.

Commands are the lines of its ```sh blocks. They run one after the other in a folder that looks like
a checkout with nothing in `runs/` yet, in the project's environment, as a reader would do it.
"""

import re
from pathlib import Path

import pytest

from tests.features.rows import rows_of_features
from tests.pages import ROOT, commands, link_checkout, run_as_reader

pytestmark = pytest.mark.slow

README = ROOT / "README.md"
_NAMES = (
    "start",
    "topology",
    "bus",
    "labelled",
    "faults",
    "realtime",
    "papers/meng2025",
    *rows_of_features("PAGES"),
)
PAGES = (
    README,
    *(ROOT / f"docs/{name}.md" for name in _NAMES),
)
COMMANDS = [command for page in PAGES for command in commands(page.read_text(encoding="utf-8"))]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return link_checkout(tmp_path_factory.mktemp("readme"))


def test_the_readme_has_commands():
    assert COMMANDS, "README.md has no ```sh block: print the commands that a reader should try"


@pytest.mark.zenoh
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_readme_runs(command: str, checkout: Path):
    run_as_reader(command, checkout)


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
