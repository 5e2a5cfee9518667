"""Commands in an interpreter of their own, with folders first on its path that no checkout has."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

# Each command in turn, whatever became of those before.
_COMMANDS = """
import sys, traceback
from concord.experiments.__main__ import main
failed = 0
for arguments in {commands!r}:
    try:
        main(arguments)
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        code = 1
    else:
        code = 0
    if code:
        failed += 1
        sys.stderr.write(f"concord {{' '.join(arguments)}}: exit code {{code}}\\n")
if failed:
    sys.exit(f"{{failed}} commands failed")
"""
# A page that draws its panels step by step, without a browser.
_PAGE = """
from pathlib import Path
from concord.dashboard.serve import open_recording
from concord.results.folder import read_description
folder = Path({folder!r})
setup = read_description(folder).setup
page = open_recording(setup, folder / "run.mcap", "127.0.0.1", 0, light=False)
for clock_s in range(1, 9):
    page.tick(float(clock_s))
assert page.page.charts.drawn[0].times.size > 1 and not page.failures.sentences()
page.close()
"""


# Compiled code stands beside its source, through all links: else each tree would be compiled anew.
_ELSEWHERE = ("PYTHONPYCACHEPREFIX", "PYTHONDONTWRITEBYTECODE")


def python(path: Path, folder: Path, program: str) -> str:
    """Run a program in `folder`, with the packages of `path` before all others; return its output.

    Raises:
        AssertionError: with its error output, if the program fails.
    """
    kept = {name: value for name, value in os.environ.items() if name not in _ELSEWHERE}
    done = subprocess.run(
        [sys.executable, "-P", "-c", program],
        cwd=folder,
        env={**kept, "PYTHONPATH": str(path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


def commands(*lines: Sequence[str]) -> str:
    """Return a program that runs commands of concord one after the other."""
    return _COMMANDS.format(commands=[list(line) for line in lines])


def page(folder: str) -> str:
    """Return a program that opens the page on the run in a folder, and draws its panels."""
    return _PAGE.format(folder=folder)
