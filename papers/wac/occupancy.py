"""Section 4 of the consensus study: what a bus that limits who may publish does to each rule.

The scenarios TRACK (`target-tracking`) and MOTOR (`dc-motor-position`, driven from the true state).
Every rule may hold old shares here; scenarios refuse that to hcmci and icf.
"""

from collections.abc import Callable, Iterator
from itertools import count
from typing import NamedTuple

from concord.papers.wac.bench import Bench, PaperScenario, VariantCell, attempt, bench_of
from concord.scenarios.catalogue import definition_named
from concord.scenarios.types.holds import Decayed, Dropped, InStep, Predicted, Raw, Renormalised
from concord.scenarios.types.rules import hold_of
from concord.studies.progress import progress
from concord.topology.spectrum import second_eigenvalue_modulus
from concord.topology.weights import from_per_node


class Variant(NamedTuple):
    """A row of a table: a rule, and one of HOLDS, what becomes of the shares of the silent."""

    rule: str
    hold: str

    @property
    def title(self) -> str:
        """How the study calls it."""
        return f"{_RULE_NAMES[self.rule]} {self.hold}"


VariantTable = dict[tuple[Variant, float], VariantCell]


class Occupancy(NamedTuple):
    """All tables; `central_rmse_m` and `central_anees` of TRACK, `track_slem` of its weights."""

    track: VariantTable
    track_one_round: VariantTable
    motor: VariantTable
    motor_one_round: VariantTable
    schedules: dict[tuple[Variant, str, float], VariantCell]
    central_rmse_m: float
    central_anees: float
    track_slem: float


_RULE_NAMES = {"wac": "WAC", "ci": "CI", "hcmci": "HCMCI-safe", "icf": "ICF"}


PLAIN, SHARP = "(D) rho=.5", "(D) rho=.5 + det"
HOLDS = {
    "raw": Raw(),
    "predict": Predicted(),
    "drop": Dropped(),
    "renorm": Renormalised(),
    "instep": InStep(),
    PLAIN: Decayed(decay=0.5, determinant_weights=False),
    SHARP: Decayed(decay=0.5),
}
HELD = [
    *(Variant("wac", name) for name in ("raw", "predict", "drop", "renorm", SHARP)),
    *(Variant("ci", name) for name in HOLDS),
    *(Variant("hcmci", name) for name in ("renorm", "drop", "raw")),
    *(Variant("icf", name) for name in ("drop", "renorm")),
]
ONE_ROUND = [
    *(Variant("ci", name) for name in ("raw", "predict", "drop", "renorm", SHARP)),
    Variant("hcmci", "renorm"),
    Variant("icf", "drop"),
    Variant("wac", "predict"),
]
MOTOR_ONE_ROUND = [Variant("ci", name) for name in ("predict", "renorm", SHARP)]
FULL = 1.0
LIMITED = (0.5, 0.25, 0.1)
SCHEDULES = ("round-robin", "hybrid", "dynamic")


def track(seed: int, runs: int = 24) -> PaperScenario:
    """Twenty nodes follow a turning target."""
    scenario = definition_named("target-tracking").defaults.with_(seed=seed, rounds=3)
    return PaperScenario("TRACK", scenario, runs, 20, position_only=True)


def motor(seed: int, runs: int = 12) -> PaperScenario:
    """Eight nodes on a ring watch a motor's position."""
    default = definition_named("dc-motor-position").defaults
    scenario = default.with_(seed=seed, rounds=3, control="truth")
    return PaperScenario("MOTOR", scenario, runs, 60, position_only=False)


def measure(tracking: PaperScenario, turning: PaperScenario) -> Occupancy:
    """Run everything."""
    schedules = [
        (variant, schedule, occupancy)
        for variant in (Variant("ci", "renorm"), Variant("ci", "predict"))
        for schedule in SCHEDULES
        for occupancy in LIMITED[1:]
    ]
    tables = (
        (tracking, HELD, 3, True),
        (tracking, ONE_ROUND, 1, False),
        (turning, HELD, 3, True),
        (turning, MOTOR_ONE_ROUND, 1, False),
    )
    total = len(schedules) + sum(len(list(_cells(rows, full))) for _, rows, _, full in tables)
    with progress("limited bus", total) as done:
        counted = count(1)

        def tell(cell: VariantCell) -> VariantCell:
            done(next(counted))
            return cell

        benches = {study.name: bench_of(study) for study in (tracking, turning)}
        filled = [
            _table(benches[study.name], rows, rounds, full=full, tell=tell)
            for study, rows, rounds, full in tables
        ]
        on_track = benches[tracking.name]
        by_schedule = {
            (variant, schedule, occupancy): tell(_try(on_track, variant, occupancy, 3, schedule))
            for variant, schedule, occupancy in schedules
        }
    return Occupancy(
        *filled,
        schedules=by_schedule,
        central_rmse_m=on_track.central_rmse,
        central_anees=on_track.central_anees,
        track_slem=second_eigenvalue_modulus(
            from_per_node(on_track.setup.weights, on_track.setup.neighbours)
        ),
    )


def _cells(variants: list[Variant], full: bool) -> Iterator[tuple[Variant, float]]:
    """Variants and occupancies; at full occupancy all variants of a rule are one, but for det."""
    for variant in variants:
        if full and _differs_when_full(variant, variants):
            yield variant, FULL
        yield from ((variant, occupancy) for occupancy in LIMITED)


def _differs_when_full(variant: Variant, variants: list[Variant]) -> bool:
    """Return whether the variant is the first of its rule, or weighs by determinant."""
    return variant.hold == SHARP or next(v for v in variants if v.rule == variant.rule) == variant


def _table(
    bench: Bench,
    variants: list[Variant],
    rounds: int,
    *,
    full: bool,
    tell: Callable[[VariantCell], VariantCell],
) -> VariantTable:
    return {
        (variant, occupancy): tell(_try(bench, variant, occupancy, rounds, "hybrid"))
        for variant, occupancy in _cells(variants, full)
    }


def _try(
    bench: Bench, variant: Variant, occupancy: float, rounds: int, schedule: str
) -> VariantCell:
    scenario = bench.study.scenario.with_(rule=variant.rule, rounds=rounds)
    if occupancy != FULL:
        scenario = scenario.with_(schedule=schedule, occupancy=occupancy)
        # The study's arbiter knows all bids.
        scenario, _ = scenario.with_known(arbiter="wtod")
    if hold_of(scenario.rule) is None:
        return attempt(bench, scenario, variant.hold)
    return attempt(bench, scenario.with_(hold=HOLDS[variant.hold]))
