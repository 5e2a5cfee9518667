"""Test the whole command line: its commands, their imports, and output without a reader."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.cli.command_line import COMMANDS, GROUPS, main
from tests.processes import CONCORD

FULL = Path("/dev/full")
# A fresh process prints the modules that a command loads, as a user waits for their loading.
LOADED_BY = """
import contextlib, io, sys
from experiments.cli.command_line import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main({arguments!r})
sys.stdout.write(" ".join(sorted({{name.partition(".")[0] for name in sys.modules}})))
"""
SLOW_TO_LOAD = {"scipy", "networkx", "xarray", "viser", "matplotlib", "h5py", "h5netcdf", "dask"}


def loaded_by(*arguments: str) -> set[str]:
    """Top-level modules that a command has loaded."""
    code = LOADED_BY.format(arguments=list(arguments))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize("name", COMMANDS | GROUPS)
def test_every_command_says_what_it_is(name: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="0"):
        main([name, "--help"])
    assert f"concord {name}" in capsys.readouterr().out


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    printed = capsys.readouterr().out
    assert all(f"• {name} " in printed for name in COMMANDS | GROUPS)


def test_an_unknown_command_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="2"):
        main(["lisst"])
    told = capsys.readouterr().err
    assert told.startswith("concord: unknown command 'lisst': did you mean 'list'? Valid names are")
    assert told.count("\n") == 1


def test_what_there_is_to_choose_from_is_told_without_what_computes():
    assert not loaded_by("list") & (SLOW_TO_LOAD | {"zenoh", "mcap"})


@pytest.mark.parametrize(
    "name", ["control", "keys", "setup", "router", "world", "node", "dashboard", "flexray"]
)
def test_a_command_loads_nothing_of_other_commands(name: str):
    assert not loaded_by(name, "--help") & SLOW_TO_LOAD


def test_the_measure_of_loading_sees_what_is_loaded():
    assert {"scipy", "networkx"} <= loaded_by("topology", "--help")


@pytest.mark.parametrize("arguments", [["list", "--json"], ["--help"]])
def test_a_reader_that_has_gone_ends_a_command_quietly(arguments: list[str]):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as output:
        done = subprocess.run(
            [*CONCORD, *arguments], stdout=output, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.skipif(not FULL.exists(), reason="needs a device that is always full")
@pytest.mark.parametrize("arguments", [["list"], ["list", "--json"]])
def test_a_disk_that_takes_no_output_is_named(arguments: list[str]):
    with FULL.open("wb") as output:
        done = subprocess.run(
            [*CONCORD, *arguments], stdout=output, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr.startswith("concord: standard output cannot be written (No space left")
    assert done.stderr.count("\n") == 1
