"""`concord lives`: processes that start, stop and die on a virtual clock, held against promises."""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import tyro

from concord.experiments.progress import progress
from concord.experiments.simulation_testing.lives.case import draw_lives
from concord.experiments.simulation_testing.lives.case_run import LivesOutcome, run_lives
from concord.experiments.simulation_testing.options import read_seeds
from concord.experiments.sweep.engines import engine_for
from concord.experiments.sweep.workers import WorkerLost
from concord.experiments.user_errors import user_errors


@dataclass(frozen=True)
class LivesOptions:
    """Which cases, and what computes them."""

    seeds: str = "1..100"
    """Seeds of the cases: 17, or 1..1000."""
    workers: int | None = None
    """Processes on this machine; one per core when left out."""
    json: bool = False
    """Print one JSON object instead of lines."""


def lives(options: Annotated[LivesOptions, tyro.conf.arg(name="")]) -> None:
    """Draw a network from each seed whose processes start, stop and die on a virtual clock, in
    lockstep or real time, and check promises on time and members."""
    with user_errors():
        seeds = read_seeds(options.seeds)
        engine = engine_for(options.workers, None)
    outcomes: dict[int, LivesOutcome] = {}
    began = time.monotonic()
    try:
        with progress("seeds", len(seeds)) as on_seeds, user_errors():
            for place, outcome in engine(_run_seed, seeds):
                outcomes[place] = outcome
                on_seeds(len(outcomes))
    except WorkerLost as error:
        sys.stderr.write(f"concord: {error}\n")
        sys.exit(1)
    in_order = [outcomes[place] for place in sorted(outcomes)]
    _show(in_order, time.monotonic() - began, options.json)
    sys.exit(1 if any(outcome.broken for outcome in in_order) else 0)


def _run_seed(seed: int) -> LivesOutcome:
    return run_lives(draw_lives(seed))


def _show(outcomes: Sequence[LivesOutcome], seconds: float, json: bool) -> None:
    broken = [outcome for outcome in outcomes if outcome.broken]
    estimates, joins = (
        sum(getattr(outcome, name) for outcome in outcomes) for name in ("estimates", "joins")
    )
    if json:
        result = {
            "cases": len(outcomes),
            "seconds": seconds,
            "estimates": estimates,
            "joins": joins,
            "failures": [outcome._asdict() for outcome in broken],
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    for outcome in broken:
        sys.stdout.write(
            f"seed {outcome.seed}: {outcome.broken}: {outcome.seen}\n"
            f"  again: concord lives --seeds {outcome.seed}\n"
        )
    held = f"{len(broken)} broke a promise" if broken else "no promise broken"
    sys.stdout.write(
        f"{estimates} estimates, {joins} returns of nodes\n"
        f"{len(outcomes)} cases in {seconds:.1f} s: {held}\n"
    )
