"""One case of torture: run it and the same without faults, and hold both against the invariants."""

from collections import Counter
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from experiments.torture_books import Books, Broken
from experiments.torture_case import Case
from experiments.torture_frames import HARMLESS, LOSING, HostileLink, read_frame_faults
from experiments.torture_verdict import History, check_consistency, check_return, history_of_run
from experiments.torture_watch import watched
from nodes import in_process
from nodes.commands import Configure
from nodes.in_process import first_come
from scenarios.build import build_node, build_world
from scenarios.script import script_of
from scenarios.setup import complete_settings, prepare


class Outcome(NamedTuple):
    """What came of a case: the invariant that broke (None: all held) and what was seen, and how
    many faults of each kind were done."""

    seed: int
    broken: str | None
    seen: str
    injected: Counter[str]


def torture(case: Case) -> Outcome:
    """Run a case to its end or to the first invariant that breaks."""
    injected: Counter[str] = Counter()
    try:
        calm = _run(_without_faults(case), Counter())
        tried = _run(case, injected)
        check_consistency(calm)
        check_consistency(tried)
        check_return(tried, calm, case.calm_step)
        if not _can_matter(case) and not tried.same_bits(calm):
            raise Broken("what does no harm changes nothing", "estimates are not the same bits")
    except Broken as broken:
        return Outcome(case.seed, broken.invariant, broken.seen, injected)
    except Exception as error:  # whatever a node raises is what is looked for
        seen = f"{type(error).__name__}: {error}"
        return Outcome(case.seed, "nothing is raised", seen, injected)
    return Outcome(case.seed, None, "", injected)


def _run(case: Case, injected: Counter[str]) -> History:
    """One run, looked at after every event."""
    setup = prepare(case.scenario)
    configs = [build_node(setup, node) for node in range(case.scenario.nodes)]
    faults = read_frame_faults(case.frame_faults)
    books = Books(case.scenario.rounds, len(configs), loses_frames=bool({*faults} & {*LOSING}))
    link = HostileLink(case.seed, faults, lambda cycle: books.step_of(cycle) >= case.calm_step)
    try:
        in_process.run(
            build_world(setup),
            [watched(config, books, case.scenario) for config in configs],
            books,
            link=link,
            pick=_pick(case.seed, faults.get("reorder", 0.0), link.injected),
            watch=books.watch,
            script=script_of(case.scenario),
            check=partial(complete_settings, setup),
        )
    finally:
        injected.update(link.injected)
        injected.update(books.changes)
    return history_of_run(setup, books)


def _pick(seed: int, reorder: float, injected: Counter[str]) -> in_process.Pick:
    """Which message comes next: mostly the oldest, with a probability any."""
    if not reorder:
        return first_come
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 2)))

    def pick(waiting: int) -> int:
        if waiting == 1 or generator.random() >= reorder:
            return 0
        place = int(generator.integers(waiting))
        injected["reorder"] += place > 0
        return place

    return pick


def _without_faults(case: Case) -> Case:
    """The same network, of which nothing becomes but what was set."""
    settings = tuple(
        f"{one.step} set " + " ".join(f"{k}={v}" for k, v in one.command.settings.items())
        for one in script_of(case.scenario)
        if isinstance(one.command, Configure)
    )
    scenario = msgspec.structs.replace(case.scenario, changes=settings)
    return msgspec.structs.replace(case, scenario=scenario, frame_faults=())


def _can_matter(case: Case) -> bool:
    """Whether any fault may change an estimate."""
    kinds = {*read_frame_faults(case.frame_faults)} - {*HARMLESS}
    return bool(kinds) or case.scenario.changes != _without_faults(case).scenario.changes
