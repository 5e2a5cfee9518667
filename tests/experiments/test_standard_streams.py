"""Commands with standard streams that are closed, and under narrow limits of the system."""

import resource
import subprocess
from pathlib import Path

import pytest

from concord.runtime.interpreter import fresh_command, fresh_variables

pytestmark = pytest.mark.slow

RUN = ("run", "--scenario", "oscillator", "--nodes", "3", "--steps", "5")


def closed(words: tuple[str, ...], streams: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A command with some standard streams closed, and the others read."""
    command = fresh_command("concord.experiments", *words)
    shell = ["sh", "-c", f'"$@" {streams}', "sh", *command]
    return subprocess.run(
        shell, env=fresh_variables(), cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("words", [RUN, ("list",), (*RUN, "--driver", "processes")])
@pytest.mark.parametrize("streams", [">&-", "2>&-", ">&- 2>&-"])
def test_a_closed_stream_takes_everything(words: tuple[str, ...], streams: str, tmp_path: Path):
    ended = closed(words, streams, tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    if words != ("list",):
        (folder,) = (tmp_path / "runs").iterdir()
        # No file of the run has got the number of the closed stream, and with it the table.
        assert b"centralised" not in (folder / "run.mcap").read_bytes()
        assert (folder / "run.nc").exists()


def test_a_mistake_with_standard_error_closed_has_its_exit_code(tmp_path: Path):
    assert closed(("plot", "nothing.nc"), "2>&-", tmp_path).returncode == 2


def test_a_narrow_address_space_is_refused_before_the_start(tmp_path: Path):
    limit = 500_000 * 1024
    ended = subprocess.run(
        fresh_command("concord.experiments", *RUN, "--driver", "processes"),
        env=fresh_variables(),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )
    assert ended.returncode == 2
    assert "address space of a process to 488 MB" in ended.stderr
    assert ended.stderr.count("\n") == 1 and not list(tmp_path.iterdir())
