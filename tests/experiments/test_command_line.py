"""Test the whole command line: its commands, their imports, and output without a reader."""

import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from concord._version import __version__
from concord.entries import DOORS, entries
from concord.experiments.cli.command_line import main
from concord.experiments.given_options import refuse_repeated
from concord.scenarios.scenario_options import offered_options
from tests.experiments.command_support import Said, concord, refused
from tests.processes import CONCORD

FULL = Path("/dev/full")
LAUNCHER = Path(__file__).parents[2] / "launch_local.py"
BASH = shutil.which("bash")
# A fresh process prints the modules that a command loads, as a user waits for their loading.
LOADED_BY = """
import contextlib, io, sys
from concord.experiments.cli.command_line import main
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


@pytest.mark.parametrize("name", entries("COMMANDS"))
def test_every_command_says_what_it_is(name: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="0"):
        main([name, "--help"])
    assert f"concord {name}" in capsys.readouterr().out


def lines_of(said: Said) -> list[str]:
    """The lines of a command that went well; none is wider than 80 columns."""
    assert (said.code, said.err) == (0, "")
    lines = said.out.splitlines()
    assert max(map(len, lines)) <= 80
    return lines


@pytest.mark.parametrize("words", [(), ("help",), ("-h",), ("--help",)])
def test_concord_alone_names_every_command_by_its_door(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
):
    lines = lines_of(concord(capsys, *words))
    assert len(lines) == 12
    first = {line.split()[0] for line in lines[1:]}
    assert {door.split()[0] for door in DOORS[:-1]} <= first
    assert set(entries("COMMANDS")) <= {word for line in lines for word in line.split()}


def test_help_all_explains_every_command_by_its_door(capsys: pytest.CaptureFixture[str]):
    lines = lines_of(concord(capsys, "help", "--all"))
    assert set(DOORS[:-1]) <= set(lines)
    assert {f"  {name}" for name in entries("COMMANDS")} <= {line[:20].rstrip() for line in lines}


def test_the_help_of_run_is_short_and_in_the_order_of_its_headings(
    capsys: pytest.CaptureFixture[str],
):
    lines = lines_of(concord(capsys, "run", "-h"))
    assert len(lines) <= 45
    options = [line.split()[0] for line in lines if line.startswith("  -")]
    assert options == [
        "--scenario", "--nodes", "--graph", "--rule", "--number", "--rounds", "--bus", "--schedule",
        "--occupancy", "--filter", "--loss", "--changes", "--steps", "--seed", "--driver", "--runs",
        "-o,", "--dashboard",
    ]  # fmt: skip
    everything = concord(capsys, "run", "--help-all").out
    named = {f"--{name.replace('_', '-')}" for name in offered_options()}
    assert named <= set(re.findall(r"--[a-z][a-z0-9-]*", everything))
    assert "--http-port" in everything and "None" not in everything


def test_the_help_of_run_adds_the_options_of_chosen_values(capsys: pytest.CaptureFixture[str]):
    usual = concord(capsys, "run", "-h").out
    assert "--window-steps" not in usual and "--number" in usual
    chosen = concord(capsys, "run", "--scenario", "oscillator", "--rule=labelled", "-h").out
    assert "--window-steps" in chosen and "--number" not in chosen and "--clutter" not in chosen
    assert "Number of sensor nodes. (at least 1) (default: 8)" in chosen
    assert "did you mean 'labelled'" in refused(concord(capsys, "run", "--rule", "labeled", "-h"))


@pytest.mark.parametrize("command", ["sweep", "design", "setup", "agree", "flexray plan"])
def test_the_help_of_other_commands_is_short_first(
    command: str, capsys: pytest.CaptureFixture[str]
):
    short = lines_of(concord(capsys, *command.split(), "--help"))
    every = lines_of(concord(capsys, *command.split(), "--help-all"))
    assert len(short) <= 60 < 200 < len(every)
    assert short[-1].startswith(f"concord {command} --help-all explains all ")


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("run --nodes eight", "--nodes eight: must be a whole number"),
        ("run --loss abc", "--loss abc: must be a number"),
        ("run --cycle-stretch x", "--cycle-stretch x: must be a number; `concord run -h`"),
        ("run --capture-nodes 1 a", "--capture-nodes a: must be a whole number"),
        ("sweep --runs x", "--runs x: must be a whole number; `concord sweep -h` explains it"),
        ("run --driver batchd", "unknown driver 'batchd': did you mean 'batched'?"),
        ("run --frobnicate 3", "concord run has no --frobnicate; `concord run --help-all` has"),
        ("run --grap ring", "concord run has no --grap: did you mean --graph?"),
        ("run ring", "concord run has no ring; `concord run --help-all` has all options"),
        ("run --rule", "--rule: its value is missing; `concord run -h` explains it"),
        ("plot", "RESULT is missing; `concord plot -h` explains it"),
        ("node setup.json a", "NODES a: must be a whole number; `concord node -h` explains it"),
        ("design", "--target-rmse is missing; `concord design -h` explains it"),
        ("flexray pln", "unknown command of concord flexray 'pln': did you mean 'plan'?"),
    ],
)
def test_words_that_are_wrong_are_refused_in_one_sentence(
    command: str, says: str, capsys: pytest.CaptureFixture[str]
):
    assert says in refused(concord(capsys, *command.split()))


def test_a_group_alone_names_its_commands(capsys: pytest.CaptureFixture[str]):
    lines = lines_of(concord(capsys, "topology"))
    assert lines[0] == "usage: concord topology COMMAND [OPTIONS]"
    assert {"show", "analyse", "compare", "generate"} <= {line.split()[0] for line in lines[2:]}


def test_an_unknown_command_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="2"):
        main(["lisst"])
    told = capsys.readouterr().err
    assert told.startswith("concord: unknown command 'lisst': did you mean 'list'? Valid names are")
    assert told.count("\n") == 1


def test_help_explains_a_command_as_its_own_option_does(capsys: pytest.CaptureFixture[str]):
    for words in ([], ["control"], ["flexray", "plan"]):
        explained = concord(capsys, "help", *words)
        assert explained == concord(capsys, *words, "--help") and explained.code == 0
    assert "unknown command 'runn': did you mean 'run'" in refused(concord(capsys, "help", "runn"))


@pytest.mark.parametrize("asked", ["--version", "version"])
def test_the_version_is_that_of_the_package(asked: str, capsys: pytest.CaptureFixture[str]):
    assert concord(capsys, asked) == (0, f"concord {__version__}\n", "")


def test_the_package_is_a_command_as_the_script_is():
    asked = [sys.executable, "-m", "concord", "version"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True)
    assert done.stdout == f"concord {__version__}\n"


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_a_completion_script_knows_commands_and_options(
    shell: str, capsys: pytest.CaptureFixture[str]
):
    printed = concord(capsys, "completion", shell)
    assert (printed.code, printed.err) == (0, "")
    assert all(name in printed.out for name in (*entries("COMMANDS"), "--cycle-stretch"))


@pytest.mark.skipif(BASH is None, reason="needs bash")
@pytest.mark.parametrize(
    ("words", "completed"),
    [("concord swee", "sweep"), ("concord run --cycle-s", "--cycle-stretch")],
)
def test_bash_completes_with_the_printed_script(
    words: str, completed: str, capsys: pytest.CaptureFixture[str]
):
    ask = f'COMP_WORDS=({words}); COMP_CWORD={words.count(" ")}; _tyro_concord; echo "$COMPREPLY"'
    script = f"{concord(capsys, 'completion', 'bash').out}\n{ask}"
    done = subprocess.run([str(BASH)], input=script, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [completed]


def test_a_far_name_gets_no_offer(capsys: pytest.CaptureFixture[str]):
    told = refused(concord(capsys, "quux"))
    assert "did you mean" not in told and told.count("'quux'. Valid names are run, ") == 1


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (
            "sweep --graph ring --graph path",
            "--graph is given twice, --graph ring and --graph path, and only one of them can hold; "
            "write --graph ring,path",
        ),
        ("design --nodes=5 --target-rmse 8 --nodes 6", "write --nodes 5,6"),
        ("sweep --runs 5 --runs 6", "--runs 5 and --runs 6, and only one of them can hold; give"),
        ("sweep -o a.nc --out b.nc", "--out is given twice, -o a.nc and --out b.nc, and"),
        ("run --occupancy_x -1 --occupancy-x -inf", "-1 and --occupancy-x -inf, and only one"),
        ("run --relay --steps 3 --no-relay", "--relay is given twice, --relay and --no-relay, and"),
        ("run --changes a b --changes c", "--changes a b and --changes c, and only one"),
        ("flexray plan --nodes 3 --nodes 4", "of them can hold; give it once"),
    ],
)
def test_a_repeated_option_is_refused(command: str, says: str, capsys: pytest.CaptureFixture[str]):
    assert says in refused(concord(capsys, *command.split()))


@pytest.mark.parametrize(
    "words",
    [
        ["run", "--changes", "2 kill 1", "4 restart 1", "--seed", "1"],
        ["node", "setup.json", "0", "1", "--connect", "tcp/a:1", "tcp/b:1"],
        ["run", "--loss", "-1", "--delay", "-1", "--no-relay", "--nodes", "3"],
        ["control", "runs/x", "--json", "--", "--json", "--json"],
    ],
)
def test_several_values_of_one_option_are_not_a_repetition(words: list[str]):
    refuse_repeated(words)


def test_the_local_launcher_takes_another_driver():
    asked = ["--driver", "batched", "--runs", "0"]
    done = subprocess.run(
        [sys.executable, str(LAUNCHER), *asked], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr == "concord: --runs 0: must be at least 1\n"


def test_the_local_launcher_has_its_own_help():
    asked = [sys.executable, str(LAUNCHER), "-h"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage: launch_local.py [OPTIONS]\n")
    assert "(default: processes)" in done.stdout


def test_what_there_is_to_choose_from_is_told_without_what_computes():
    assert not loaded_by("list") & (SLOW_TO_LOAD | {"zenoh", "mcap"})


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["control", "keys", "setup", "router", "environment", "node", "dashboard", "flexray"]
)
def test_a_command_loads_nothing_of_other_commands(name: str):
    assert not loaded_by(name, "--help") & SLOW_TO_LOAD


def test_the_summaries_of_all_commands_are_told_without_loading_one():
    assert not loaded_by("--help") & (SLOW_TO_LOAD | {"msgspec", "zenoh"})


def test_a_run_loads_no_library_of_data_sets(tmp_path: Path):
    """These take longer to load than a small run takes."""
    asked = ("--scenario", "oscillator", "--nodes", "3", "--steps", "4")
    loaded = loaded_by("run", *asked, "--out", str(tmp_path / "run"))
    assert (tmp_path / "run" / "run.nc").exists()
    assert not loaded & {"xarray", "pandas", "dask", "matplotlib"}


def test_the_measure_of_loading_sees_what_is_loaded():
    assert {"scipy", "networkx"} <= loaded_by("topology", "--help")


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
@pytest.mark.parametrize(
    ("command", "written"),
    [
        ("run --driver batched --scenario oscillator --nodes 3 --steps 40 --runs 5 --out run",
         ["+- 0.", "5 runs from run 0 on"]),
        ("run --scenario oscillator --nodes 3 --steps 20 --out run", ["centralised", "ANEES"]),
    ],
)  # fmt: skip
def test_an_encoding_without_a_character_gets_another_one(
    command: str, written: list[str], encoding: str, tmp_path: Path
):
    locale = {"PYTHONUTF8": "0", "LC_ALL": "C", "PYTHONIOENCODING": encoding}
    done = subprocess.run(
        [*CONCORD, *command.split()],
        cwd=tmp_path,
        env={**os.environ, **locale},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    output = done.stdout.decode(encoding)
    if encoding == "latin-1":
        written = [text.replace("+- ", "\u00b1 ") for text in written]
    assert all(text in output for text in written), output
    assert "?" not in output and "\\u" not in output


def test_every_character_has_a_plain_form():
    text = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="concord")
    text.write("3 ± 2 m/s² ≤ √Π, β = 5 µs …, Cramér ┏━┓│")
    text.seek(0)
    assert text.read() == "3 +- 2 m/s^2 <= sqrt Pi, beta = 5 us ., Cramer +-+|"


@pytest.mark.parametrize("arguments", [["list"], ["list", "--json"], ["--help"]])
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


# An interruption falls into a callback, which cannot raise it, and the command goes on to wait.
LOST = """
import time
from concord.experiments.cli import command_line
class Callback:
    def __del__(self):
        raise KeyboardInterrupt
def command() -> None:
    Callback()
    time.sleep(60)
command_line._command = lambda words: (command, 1)
command_line.main(["work"])
"""


def test_a_ctrl_c_that_falls_into_a_callback_is_not_lost():
    done = subprocess.run(
        [sys.executable, "-c", LOST], capture_output=True, text=True, timeout=50, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")
