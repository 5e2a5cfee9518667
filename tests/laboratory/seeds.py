"""Random cases from seeds, held against what must never break.

`drawn` draws scenarios and faults. `lives` draws processes that start, stop and die on a virtual
clock.
"""

import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, Protocol, TypeVar

import msgspec
import tyro

from concord.experiments.scenario_flags import flags_of, said_in
from concord.experiments.user_errors import user_errors
from concord.scenarios.scenario_options import offered_options
from concord.studies.check.shrinking import shrink
from concord.studies.progress import progress
from concord.studies.sweep.engines import engine_for
from concord.studies.sweep.specification import FIELDS
from tests.laboratory.case import (
    SimulationCase,
    draw_case,
    replay_command,
    run_command,
    smaller_cases,
)
from tests.laboratory.case_run import SimulationOutcome, run_case
from tests.laboratory.coverage import State, covering, states_of
from tests.laboratory.lives.case import draw_lives
from tests.laboratory.lives.network import LivesOutcome, run_lives
from tests.laboratory.wire import read_wire

MOST_SHRUNK = 3

if TYPE_CHECKING:

    class FixedOptions:
        """Fields that are the same in all cases; others are drawn from the seed."""

else:
    FixedOptions = flags_of("FixedOptions", FIELDS.values(), listing=True)


class Outcome(Protocol):
    """The result of the case of a seed; `broken` is None where all held."""

    @property
    def broken(self) -> str | None: ...


Found = TypeVar("Found", bound=Outcome)


@dataclass(frozen=True, kw_only=True)
class LivesOptions:
    """Which cases, and what computes them."""

    seeds: str = "1..100"
    """Seeds of the cases: 17, or 1..1000."""
    workers: int | None = None
    """Processes on this machine; one per core when left out."""
    json: bool = False
    """Print one JSON object instead of lines."""


@dataclass(frozen=True, kw_only=True)
class DrawnOptions(LivesOptions):
    """Which cases, and what computes them."""

    most: int | None = None
    """Run only so many of the seeds: those whose cases together have the most pairs of faults at
    once in each phase of a node. All when left out."""
    wire: str | None = None
    """Faults that no word of --changes names, each with its probability: 'vanish 0.05, garbage 0.2,
    shuffle 0.5'; drawn from the seed when left out."""


def drawn(
    fixed: Annotated[FixedOptions, tyro.conf.arg(name="")],
    output: Annotated[DrawnOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Draw a scenario and a swarm of faults from each seed, run it, and check after every cycle."""
    with user_errors():
        seeds = read_seeds(output.seeds)
        wire = {} if output.wire is None else {"wire": output.wire}
        fields = fixed_fields({**said_in(fixed), **wire})
        # Options that no case can meet are refused before the first run.
        draw_case(seeds[0], fields)
        if output.most is not None and output.most < 1:
            raise ValueError(f"--most {output.most}: must be at least 1")
    chosen = seeds if output.most is None else _covering(seeds, output.most, fields, output.json)
    _of_seeds(
        partial(_run_seed, fields),
        chosen,
        output.workers,
        partial(_show, chosen, fields, output.json),
        output.json,
    )


def _covering(seeds: range, most: int, fields: dict[str, Any], as_json: bool) -> list[int]:
    """Return the seeds whose cases together reach the most states, and say how many."""
    with progress("cases drawn", len(seeds), as_json=as_json) as on_seeds:
        found: dict[int, frozenset[State]] = {}
        for seed in seeds:
            found[seed] = states_of(draw_case(seed, fields))
            on_seeds(len(found))
    chosen = covering(seeds, most, found.__getitem__)
    reached, all_of, first = (
        len(frozenset[State]().union(*(found[seed] for seed in several)))
        for several in (chosen, seeds, seeds[:most])
    )
    sys.stderr.write(
        f"{len(chosen)} of {len(seeds)} seeds reach {reached} of {all_of} states; the first "
        f"{len(chosen)} reach {first}\n"
    )
    return chosen


def _of_seeds(
    run: Callable[[int], Found],
    seeds: Sequence[int],
    workers: int | None,
    show: Callable[[Sequence[Found], float], None],
    as_json: bool,
) -> NoReturn:
    """Compute the cases of seeds, and show those that came to their end, also after Ctrl-C.

    The exit code is 1 where one is broken.
    """
    with user_errors():
        engine = engine_for(workers, None)
    outcomes: dict[int, Found] = {}
    began = time.monotonic()

    def show_all() -> None:
        show([outcomes[place] for place in sorted(outcomes)], time.monotonic() - began)

    try:
        with progress("seeds", len(seeds), as_json=as_json) as on_seeds, user_errors():
            for place, outcome in engine(run, seeds):
                outcomes[place] = outcome
                on_seeds(len(outcomes))
    except KeyboardInterrupt:
        show_all()
        raise
    show_all()
    sys.exit(1 if any(outcome.broken for outcome in outcomes.values()) else 0)


def _run_seed(fields: dict[str, Any], seed: int) -> SimulationOutcome:
    return run_case(draw_case(seed, fields))


def _show(
    seeds: Sequence[int],
    fields: dict[str, Any],
    json: bool,
    outcomes: Sequence[SimulationOutcome],
    seconds: float,
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
        case = shrink(case, smaller_cases, breaks)
    return {
        "seed": outcome.seed,
        "invariant": outcome.broken,
        "seen": run_case(case).seen,
        "again": replay_command(case),
        "run": run_command(case),
    }


def lives(options: Annotated[LivesOptions, tyro.conf.arg(name="")]) -> None:
    """Draw a network from each seed whose processes start, stop and die on a virtual clock, in
    lockstep or real time, and check promises on time and members."""
    with user_errors():
        seeds = read_seeds(options.seeds)
    _of_seeds(_run_lives, seeds, options.workers, partial(_show_lives, options.json), options.json)


def _run_lives(seed: int) -> LivesOutcome:
    return run_lives(draw_lives(seed))


def _show_lives(json: bool, outcomes: Sequence[LivesOutcome], seconds: float) -> None:
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
            f"  again: python -m tests.laboratory lives --seeds {outcome.seed}\n"
        )
    held = f"{len(broken)} broke a promise" if broken else "no promise broken"
    sys.stdout.write(
        f"{estimates} estimates, {joins} returns of nodes\n"
        f"{len(outcomes)} cases in {seconds:.1f} s: {held}\n"
    )


def fixed_fields(asked: Mapping[str, str]) -> dict[str, Any]:
    """Return the values that texts mean, by the fields of a case.

    Raises:
        ValueError: a text that means no value of its field, or no fault.
    """
    fixed: dict[str, Any] = {}
    for name, text in asked.items():
        if name in ("changes", "wire"):
            fixed[name] = tuple(part.strip() for part in text.split(",") if part.strip())
            continue
        kind = reduce(or_, offered_options()[name].kinds)
        try:
            fixed[name] = msgspec.convert(text, kind, strict=False)
        except msgspec.ValidationError as error:
            raise ValueError(f"--{name.replace('_', '-')} {text}: {error}") from None
    read_wire(fixed.get("wire", ()))
    return fixed


def read_seeds(text: str) -> range:
    """Return the seeds of "1..1000", or the one of "17".

    Raises:
        ValueError: it names none.
    """
    first, dots, last = text.partition("..")
    numbers = [part for part in (first, last if dots else first)]
    if not all(number.isdecimal() for number in numbers) or int(numbers[0]) > int(numbers[1]):
        raise ValueError(f"--seeds {text}: must be a number, or two as in 1..1000, the lower first")
    return range(int(numbers[0]), int(numbers[1]) + 1)
