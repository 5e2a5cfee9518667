"""`concord torture`: random scenarios under random faults, held against what must never break."""

import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import msgspec
import tyro

from concord.experiments.progress import progress
from concord.experiments.scenario_flags import said_in
from concord.experiments.simulation_testing.case import SimulationCase
from concord.experiments.simulation_testing.case_run import SimulationOutcome, run_case
from concord.experiments.simulation_testing.draw import draw_case
from concord.experiments.simulation_testing.options import FixedOptions, fixed_fields, read_seeds
from concord.experiments.simulation_testing.shrink import replay_command, run_command, shrink
from concord.experiments.sweep.engines import engine_for
from concord.experiments.sweep.workers import WorkerLost
from concord.experiments.user_errors import user_errors

MOST_SHRUNK = 3


@dataclass(frozen=True, kw_only=True)
class SimulationTestingOptions:
    """Which cases, and what computes them."""

    seeds: str = "1..100"
    """Seeds of the cases: 17, or 1..1000."""
    workers: int | None = None
    """Processes on this machine; one per core when left out."""
    wire: str | None = None
    """Faults that no word of --changes names, each with its probability: 'vanish 0.05, garbage 0.2,
    shuffle 0.5'; drawn from the seed when left out."""
    json: bool = False
    """Print one JSON object instead of lines."""


def simulation_testing(
    fixed: Annotated[FixedOptions, tyro.conf.arg(name="")],
    output: Annotated[SimulationTestingOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Draw a scenario and a swarm of faults from each seed, run it, and check after every cycle."""
    with user_errors():
        seeds = read_seeds(output.seeds)
        wire = {} if output.wire is None else {"wire": output.wire}
        fields = fixed_fields({**said_in(fixed), **wire})
        # Options that no case can meet are refused before the first run.
        draw_case(seeds[0], fields)
        engine = engine_for(output.workers, None)
    outcomes: dict[int, SimulationOutcome] = {}
    began = time.monotonic()
    try:
        with progress("seeds", len(seeds)) as on_seeds, user_errors():
            for place, outcome in engine(partial(_run_seed, fields), seeds):
                outcomes[place] = outcome
                on_seeds(len(outcomes))
    except KeyboardInterrupt:
        _show(seeds, fields, list(outcomes.values()), time.monotonic() - began, output.json)
        raise
    except WorkerLost as error:
        sys.stderr.write(f"concord: {error}\n")
        sys.exit(1)
    in_order = [outcomes[place] for place in sorted(outcomes)]
    _show(seeds, fields, in_order, time.monotonic() - began, output.json)
    sys.exit(1 if any(outcome.broken for outcome in in_order) else 0)


def _run_seed(fields: dict[str, Any], seed: int) -> SimulationOutcome:
    return run_case(draw_case(seed, fields))


def _show(
    seeds: range,
    fields: dict[str, Any],
    outcomes: Sequence[SimulationOutcome],
    seconds: float,
    json: bool,
) -> None:
    injected: Counter[str] = sum((outcome.injected for outcome in outcomes), Counter())
    struck: Counter[str] = sum((outcome.struck for outcome in outcomes), Counter())
    broken = [outcome for outcome in outcomes if outcome.broken]
    failures = [_failure(outcome, fields, n < MOST_SHRUNK) for n, outcome in enumerate(broken)]
    if json:
        result = {
            "seeds": [seeds[0], seeds[-1]],
            "cases": len(outcomes),
            "seconds": seconds,
            "injected": injected,
            "struck": struck,
            "failures": failures,
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    for failure in failures:
        sys.stdout.write(
            f"seed {failure['seed']}: {failure['invariant']}: {failure['seen']}\n"
            f"  again: {failure['again']}\n"
            f"  to look at: {failure['run']}\n"
        )
    held = f"{len(broken)} broke an invariant" if broken else "no invariant broken"
    sys.stdout.write(
        f"faults injected: {_listed(injected)}\n"
        f"frames and turns struck: {_listed(struck)}\n"
        f"{len(outcomes)} of {len(seeds)} cases in {seconds:.1f} s: {held}\n"
    )


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{kind} {count}" for kind, count in counts.most_common()) or "none"


def _failure(outcome: SimulationOutcome, fields: dict[str, Any], smaller: bool) -> dict[str, Any]:
    case = draw_case(outcome.seed, fields)

    def breaks(tried: SimulationCase) -> bool:
        return run_case(tried).broken == outcome.broken

    if smaller:
        sys.stderr.write(f"seed {outcome.seed}: {outcome.broken}; making the case smaller ...\n")
        case = shrink(case, breaks)
    return {
        "seed": outcome.seed,
        "invariant": outcome.broken,
        "seen": run_case(case).seen,
        "again": replay_command(case),
        "run": run_command(case),
    }
