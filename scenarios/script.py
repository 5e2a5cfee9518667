"""What becomes of a network in a run, checked before it starts: changes with their steps."""

from collections.abc import Callable, Sequence

from nodes.changes import UNCHANGED, Joined, Left, Set, Settings, Standing, after
from nodes.commands import (
    ChangeCommand,
    Configure,
    Kill,
    Pause,
    Refused,
    Restart,
    Resume,
    Speed,
    Step,
    check_command,
    in_words,
)
from nodes.conductor import Scripted
from scenarios.scenario import Scenario


def script_of(scenario: Scenario) -> tuple[Scripted, ...]:
    """The changes of a scenario in the order of their steps.

    Raises:
        ValueError: a line that is none.
    """
    lines = [_line(line, scenario.steps) for line in scenario.changes]
    return tuple(sorted(lines, key=lambda one: one.step))


def _line(line: str, steps: int) -> Scripted:
    number, _, words = line.strip().partition(" ")
    if not number.isdecimal() or int(number) >= steps:
        raise ValueError(
            f"--changes {line!r}: must begin with a step, 0 to {steps - 1}, as in '10 kill 3'"
        )
    try:
        command = in_words(words.split())
    except Refused as refused:
        raise ValueError(f"--changes {line!r}: {refused}") from None
    if isinstance(command, Pause | Resume | Step | Speed):
        raise ValueError(f"--changes {line!r}: changes no number; say it to a network that runs")
    return Scripted(int(number), command)


def check_script(
    scenario: Scenario,
    neighbours: Sequence[Sequence[int]],
    complete: Callable[[Settings], Settings],
) -> None:
    """Refuse changes that cannot follow upon one another; `complete` refuses settings.

    Raises:
        ValueError: naming the line, and why not.
    """
    standing = UNCHANGED
    for line, (step, command) in zip(_in_order(scenario), script_of(scenario), strict=True):
        try:
            check_command(command, neighbours, standing, paused=False)
            standing = _stands(standing, step, command, neighbours, complete)
        except ValueError as refused:
            raise ValueError(f"--changes {line!r}: {refused}") from None


def _in_order(scenario: Scenario) -> list[str]:
    return sorted(scenario.changes, key=lambda line: int(line.split()[0]))


def _stands(
    standing: Standing,
    step: int,
    command: ChangeCommand,
    neighbours: Sequence[Sequence[int]],
    complete: Callable[[Settings], Settings],
) -> Standing:
    """What matters of it to the changes that follow."""
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
            return after(standing, step, Set(complete({**standing.settings, **settings})))
    return standing
