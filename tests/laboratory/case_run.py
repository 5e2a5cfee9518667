"""Run one case of simulation testing, with and without faults, and check the invariants."""

from collections import Counter
from functools import partial
from typing import NamedTuple

import msgspec

from concord.nodes.commands import Configure
from concord.runtime import in_process
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import complete_settings, prepare
from concord.scenarios.script import script_of
from tests.laboratory.broken import Broken
from tests.laboratory.case import SimulationCase
from tests.laboratory.ledger import OracleLedger
from tests.laboratory.run_record import RunRecord
from tests.laboratory.script import is_harmless
from tests.laboratory.verdict import (
    EstimateHistory,
    check_bound,
    check_consistency,
    check_return,
    history_of_run,
)
from tests.laboratory.watch import watched
from tests.laboratory.wire import LOSING, Wire, read_wire


class SimulationOutcome(NamedTuple):
    """Outcome of a case.

    Attributes:
        broken: the invariant that broke; None if all held. seen: the observation that broke it.
        injected: how often each word occurs in the scripts, and how often the wire acted.
        struck: number of frames and turns that each fault word affected.
    """

    seed: int
    broken: str | None
    seen: str
    injected: Counter[str]
    struck: Counter[str]


def run_case(case: SimulationCase) -> SimulationOutcome:
    """Run a case to its end or to the first invariant that breaks."""
    injected = Counter(line.split()[1] for line in case.scenario.changes)
    struck: Counter[str] = Counter()
    try:
        calm = _run(_without_faults(case), Counter(), Counter())
        tried = _run(case, injected, struck)
        for run in (calm, tried):
            check_consistency(run)
            check_bound(run)
        check_return(tried, calm, case.calm_step)
        if _is_harmless(case) and not tried.same_bits(calm):
            raise Broken("what does no harm changes nothing", "estimates are not the same bits")
    except Broken as broken:
        return SimulationOutcome(case.seed, broken.invariant, broken.seen, injected, struck)
    except Exception as error:  # whatever a node raises is what is looked for
        seen = f"{type(error).__name__}: {error}"
        return SimulationOutcome(case.seed, "nothing is raised", seen, injected, struck)
    return SimulationOutcome(case.seed, None, "", injected, struck)


def _run(case: SimulationCase, injected: Counter[str], struck: Counter[str]) -> EstimateHistory:
    """One run, looked at after every event."""
    setup = prepare(case.scenario)
    configs = [build_node(setup, node) for node in range(case.scenario.nodes)]
    faults, calm_step = read_wire(case.wire), case.calm_step
    bus, loses_frames = configs[0].bus, bool({*faults} & {*LOSING})
    record = RunRecord(bus, case.scenario.rounds)
    ledger = OracleLedger(record, len(configs), loses_frames)
    wire = Wire(
        case.seed, faults, lambda cycle: record.step_of(cycle) >= calm_step, bus.frame_format
    )
    try:
        in_process.run(
            build_environment(setup),
            [watched(config, ledger, case.scenario) for config in configs],
            record,
            link=wire.carry,
            pick=wire.pick,
            watch=ledger.watch,
            script=script_of(case.scenario),
            check=partial(complete_settings, setup),
        )
    finally:
        injected.update(wire.injected)
        struck.update(ledger.struck)
    return history_of_run(setup, record)


def _without_faults(case: SimulationCase) -> SimulationCase:
    """Return the same network without faults; only its settings change."""
    settings = tuple(
        f"{one.step} set " + " ".join(f"{k}={v}" for k, v in one.command.settings.items())
        for one in script_of(case.scenario)
        if isinstance(one.command, Configure)
    )
    scenario = msgspec.structs.replace(case.scenario, changes=settings)
    return msgspec.structs.replace(case, scenario=scenario, wire=())


def _is_harmless(case: SimulationCase) -> bool:
    """Return whether no fault may change an estimate."""
    return not {*read_wire(case.wire)} & {*LOSING} and is_harmless(case.scenario)
