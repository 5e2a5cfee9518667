"""Seeds whose cases together reach the most states: phases with the faults that stand in them.

A bug of two faults together shows only where both stand. Blind drawing repeats common pairs and
misses rare ones. The states follow from the script alone, so the choice costs no run.
"""

from collections.abc import Callable, Sequence
from itertools import combinations

from concord.nodes.changes import UNCHANGED, Fault, Joined, Left, Set, Standing, after
from concord.nodes.commands import ChangeCommand, Configure, Inject, Kill, Restart
from concord.nodes.faults.vocabulary import PASSING
from concord.nodes.node_state import Phase
from concord.nodes.run_controller import link_changes
from concord.scenarios.preparation import complete_settings, prepare
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from tests.laboratory.case import SimulationCase
from tests.laboratory.script import contends
from tests.laboratory.wire import read_wire

State = tuple[Phase, tuple[str, ...]]


def states_of(case: SimulationCase) -> frozenset[State]:
    """Return the states that a case reaches: each phase with one or two standing faults."""
    setup, script = prepare(case.scenario), script_of(case.scenario)
    wire, standing = {*read_wire(case.wire)}, UNCHANGED
    is_contended = contends(setup, {})
    found: set[State] = set()
    for step in range(case.scenario.steps):
        commands = [one.command for one in script if one.step == step]
        for command in commands:
            standing = _after(setup, standing, step, command)
        if any(isinstance(command, Configure) for command in commands):
            is_contended = contends(setup, standing.settings)
        phases = [Phase.MEASUREMENT, Phase.SHARES]
        phases += [Phase.CHANGE] * bool(commands) + [Phase.GRANT] * is_contended
        words = sorted(words_of(standing, step) | (wire if step < case.calm_step else set()))
        together = [*((word,) for word in words), *combinations(words, 2)]
        found.update((phase, several) for phase in phases for several in together)
    return frozenset(found)


def words_of(standing: Standing, step: int) -> set[str]:
    """Return the words of the faults that a network has in a step; `cut` also for partitions."""
    words = {
        fault.kind
        for fault in standing.faults
        if fault.numbers[0]
        and not (fault.kind in PASSING and step >= fault.first_step + fault.numbers[0])
    }
    others = {"kill": standing.out_since, "cut": standing.cuts, "loss": standing.losses}
    words |= {word for word, found in others.items() if found}
    return words | ({"loss"} if standing.loss else set())


def _after(setup: Setup, standing: Standing, step: int, command: ChangeCommand) -> Standing:
    match command:
        case Kill(node):
            return after(standing, step, Left(node))
        case Restart(node):
            return after(standing, step, Joined(node))
        case Configure(settings):
            wanted = complete_settings(setup, standing.settings, settings)
            return after(standing, step, Set(wanted))
        case Inject(kind, nodes, numbers):
            return after(standing, step, Fault(kind, tuple(nodes), numbers, step))
    for change in link_changes(command, setup.neighbours, standing):
        standing = after(standing, step, change)
    return standing


def covering(
    seeds: Sequence[int], most: int, states: Callable[[int], frozenset[State]]
) -> list[int]:
    """Return `most` of the seeds, ascending, each chosen because it adds the most new states."""
    reached, chosen = set[State](), list[int]()
    found = {seed: states(seed) for seed in seeds}
    while found and len(chosen) < most:
        best = max(found, key=lambda seed: (len(found[seed] - reached), -seed))
        reached |= found.pop(best)
        chosen.append(best)
    return sorted(chosen)
