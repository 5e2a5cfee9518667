"""The changes of a network in a run, with their steps, checked before the run starts."""

from collections.abc import Callable, Sequence
from pathlib import Path

from concord.nodes.changes import UNCHANGED, Joined, Left, Set, Settings, Standing, after
from concord.nodes.command_checks import check_command
from concord.nodes.commands import (
    ChangeCommand,
    Configure,
    Inject,
    Kill,
    Pause,
    Restart,
    Resume,
    Scripted,
    Speed,
    Step,
    in_words,
)
from concord.nodes.faults.active import Equipment
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.option import require_kind

_FILE = "file:"


def with_files(changes: str | Sequence[str]) -> tuple[str, ...]:
    """The lines of a script, where `file:PATH` stands for those of a file: one change in each,
    empty ones and what comes after `#` left out. A text alone is one change.

    Raises:
        ValueError: a file that cannot be read, or a line of one that is no change: which, and why.
    """
    require_kind("changes", changes, (str, Sequence), "a text, or a list of texts")
    several = [changes] if isinstance(changes, str) else changes
    return tuple(line for change in several for line in _expanded(change))


def _expanded(change: str) -> list[str]:
    if not change.startswith(_FILE):
        return [change]
    path = Path(change.removeprefix(_FILE))
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "is no text"
        raise ValueError(f"--changes {change}: cannot be read ({why})") from None
    lines = []
    for number, whole in enumerate(text.splitlines(), 1):
        line = whole.partition("#")[0].strip()
        if line:
            try:
                _read(line)
            except ValueError as error:
                raise ValueError(f"{path}, line {number}: {line!r}: {error}") from None
            lines.append(line)
    return lines


def script_of(scenario: Scenario) -> tuple[Scripted, ...]:
    """The changes of a scenario in the order of their steps.

    Raises:
        ValueError: a line that is none.
    """
    lines = [_line(line, scenario.steps) for line in scenario.changes]
    return tuple(sorted(lines, key=lambda one: one.step))


def _line(line: str, steps: int) -> Scripted:
    try:
        scripted = _read(line)
        if scripted.step >= steps:
            raise ValueError(f"must begin with a step, 0 to {steps - 1}, as in '10 kill 3'")
    except ValueError as error:
        raise ValueError(f"--changes {line!r}: {error}") from None
    return scripted


def _read(line: str) -> Scripted:
    """A change and its step.

    Raises:
        ValueError: why it is none.
    """
    number, _, words = line.strip().partition(" ")
    if not (number.isascii() and number.isdecimal()):
        raise ValueError("must begin with the number of a step, as in '10 kill 3'")
    command = in_words(words.split())
    if isinstance(command, Pause | Resume | Step | Speed):
        raise ValueError("changes no number; say it to a network that runs")
    return Scripted(int(number), command)


def check_script(
    scenario: Scenario,
    linked: Callable[[Settings], Sequence[Sequence[int]]],
    complete: Callable[[Settings, Settings], Settings],
    equip: Callable[[Settings], Equipment],
) -> None:
    """Refuse changes that cannot follow upon one another; `complete` refuses settings, `linked` and
    `equip` say whom each node of a network with such settings hears, and what can be wrong in it.

    Raises:
        ValueError: naming the line, and why not.
    """
    standing, script, neighbours = UNCHANGED, script_of(scenario), linked({})
    for line, (step, command) in zip(_in_order(scenario), script, strict=True):
        try:
            equipment = equip(standing.settings) if isinstance(command, Inject) else Equipment()
            check_command(command, neighbours, standing, False, equipment)
            standing = _stands(standing, step, command, neighbours, complete)
            if isinstance(command, Configure):
                neighbours = linked(standing.settings)
        except ValueError as refused:
            raise ValueError(f"--changes {line!r}: {refused}") from None


def _in_order(scenario: Scenario) -> list[str]:
    return sorted(scenario.changes, key=lambda line: int(line.split()[0]))


def _stands(
    standing: Standing,
    step: int,
    command: ChangeCommand,
    neighbours: Sequence[Sequence[int]],
    complete: Callable[[Settings, Settings], Settings],
) -> Standing:
    """Return the state after a command, as far as later changes depend on it."""
    match command:
        case Kill(node):
            return after(standing, step, Left(node))
        case Restart(node):
            if not set(neighbours[node]) - set(standing.absent):
                raise ValueError(
                    "no neighbour is there that could say what to believe; restart one before"
                )
            return after(standing, step, Joined(node))
        case Configure(settings):
            return after(standing, step, Set(complete(standing.settings, settings)))
    return standing
