"""The changes of a script, computed before the run: arrays have no environment to ask.

Departures of nodes, and the belief with which each node returns, are as
`concord.nodes.run_controller` decides them where fresh processes are ready at once.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from concord.nodes.changes import UNCHANGED, Joined, Left, Set, Settings, Standing, after
from concord.nodes.command_checks import check_command
from concord.nodes.commands import ChangeCommand, Configure, Inject, Kill, Restart, Scripted


class ScriptedChange(NamedTuple):
    """State of the network from `step` on.

    `joined` are (node, whose belief it begins with); where all begin `anew`, with what they
    believe, other settings hold.
    """

    step: int
    standing: Standing
    joined: tuple[tuple[int, int], ...]
    anew: bool


def foreseen(
    script: Sequence[Scripted],
    neighbours: Sequence[Sequence[int]],
    steps: int,
    rounds: int,
    complete: Callable[[Settings, Settings], Settings],
) -> tuple[ScriptedChange, ...]:
    """When a network in which node i hears neighbours[i], of so many rounds, will change, and how.

    `complete` completes settings, as in `concord.nodes.run_controller.ProcessStarter`.
    """
    standing, ready = UNCHANGED, set[int]()
    changes: list[ScriptedChange] = []
    for step in range(steps):
        due = [one.command for one in script if one.step == step]
        if not (due or ready):
            continue
        before = standing
        for command in due:
            with suppress(ValueError):
                # Two commands that were both in order may not be so together.
                check_command(command, neighbours, standing, paused=False)
                standing = _stands(standing, step, command, neighbours, rounds, complete)
                if isinstance(command, Restart):
                    ready.add(command.node)
        believers = set(range(len(neighbours))).difference(before.absent)
        joined: list[tuple[int, int]] = []
        while able := _able(ready, neighbours, believers if step else None, standing):
            joined += able
            for node, _ in able:
                ready.discard(node)
                standing = after(standing, step, Joined(node))
        anew = any(isinstance(command, Configure) for command in due)
        changes.append(ScriptedChange(step, standing, tuple(joined), anew))
    return tuple(changes)


def _stands(
    standing: Standing,
    step: int,
    command: ChangeCommand,
    neighbours: Sequence[Sequence[int]],
    rounds: int,
    complete: Callable[[Settings, Settings], Settings],
) -> Standing:
    """Return the state of the network after a command that takes effect at `step`."""
    match command:
        case Kill(node):
            return after(standing, step, Left(node))
        case Restart() | Inject():
            # Other faults remove no node, and have no array form.
            return standing
        case Configure(settings):
            wanted = complete(standing.settings, settings)
            past = (step - standing.first_step) * int(standing.settings.get("rounds", rounds))
            return after(standing, step, Set(wanted, standing.first_cycle + past))
        case _:
            # Only here: most scripts cut no link, and a controller loads the environment.
            from concord.nodes.run_controller import link_changes

            for change in link_changes(command, neighbours, standing):
                standing = after(standing, step, change)
            return standing


def _able(
    ready: set[int],
    neighbours: Sequence[Sequence[int]],
    believers: set[int] | None,
    standing: Standing,
) -> list[tuple[int, int]]:
    """Return (ready node, neighbour that tells it what to believe), where such a neighbour exists.

    It is the first neighbour that is present and was among the `believers` of the step before. None
    is before the first step, when all have the prior.
    """
    if believers is None:
        return [(node, node) for node in sorted(ready)]
    present = believers.difference(standing.absent)
    told = [(node, [j for j in neighbours[node] if j in present]) for node in sorted(ready)]
    return [(node, heard[0]) for node, heard in told if heard]
