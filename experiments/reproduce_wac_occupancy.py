"""Section 4 of the consensus study: what a bus that limits who may publish does to each rule.

The scenarios TRACK (`target-tracking`) and MOTOR (`dc-motor-position`, driven from the true state),
run as lanes of one array program. Slots hold any share, however many FlexRay frames it takes, and
every rule may hold old shares: the network itself refuses that to hcmci and icf. Intervals are of
95 %, by the bootstrap over runs.
"""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from experiments.metrics import nees
from experiments.progress import progress
from experiments.reproduce_wac_lanes import averaging_of, centralised, estimate, wire
from experiments.reproduce_wac_runs import Runs, simulate
from filters import hold
from filters.gaussian import Gaussian
from nodes.belief_consensus import HoldPolicy
from nodes.messages import Array
from scenarios.bus_plan import build_schedule
from scenarios.catalogue import kind_of
from scenarios.scenario import Scenario
from scenarios.setup import prepare
from topology.analysis import second_eigenvalue_modulus

RESAMPLES = 2000


class Study(NamedTuple):
    """A scenario of section 4. Errors count from `first_step` on. `position_only`: of the position,
    relative to the centralised filter; else of all states, each in its standard deviation there."""

    name: str
    scenario: Scenario
    runs: int
    first_step: int
    position_only: bool


class Variant(NamedTuple):
    """A row of a table: a rule, and one of HOLDS, what becomes of the shares of the silent."""

    rule: str
    hold: str

    @property
    def title(self) -> str:
        """How the study calls it."""
        return f"{_RULE_NAMES[self.rule]} {self.hold}"


class Cell(NamedTuple):
    """One variant at one occupancy: RMSE with its interval, disagreement, ANEES of the network and
    of its worst node."""

    rmse: float
    low: float
    high: float
    disagreement: float
    anees: float
    anees_worst: float


Table = dict[tuple[Variant, float], Cell]


class Occupancy(NamedTuple):
    """All tables; `central_rmse_m` and `central_anees` of TRACK, `track_slem` of its weights."""

    track: Table
    track_one_round: Table
    motor: Table
    motor_one_round: Table
    schedules: dict[tuple[Variant, str, float], Cell]
    central_rmse_m: float
    central_anees: float
    track_slem: float


_RULE_NAMES = {"wac": "WAC", "ci": "CI", "hcmci": "HCMCI-safe", "icf": "ICF"}


def _by_age(
    weigh: Callable[[Array, np.ndarray], Array],
    base: Array,
    ages: np.ndarray,
    _covs: Array,
    _turn: int,
) -> Array:
    return weigh(base, ages)


def _decayed(determinant: bool, base: Array, ages: np.ndarray, covs: Array, _turn: int) -> Array:
    return hold.held_weights(base, ages, covs, DECAY, determinant)


def _in_step(base: Array, ages: np.ndarray, _covs: Array, turn: int) -> Array:
    return hold.in_step(base, ages, turn)


DECAY = 0.5
PLAIN, SHARP = "(D) ρ=.5", "(D) ρ=.5 + det"
HOLDS = {
    "raw": HoldPolicy(partial(_by_age, hold.full), carried=False),
    "predict": HoldPolicy(partial(_by_age, hold.full), carried=True),
    "drop": HoldPolicy(partial(_by_age, hold.drop), carried=False),
    "renorm": HoldPolicy(partial(_by_age, hold.renormalise), carried=False),
    "instep": HoldPolicy(_in_step, carried=False),
    PLAIN: HoldPolicy(partial(_decayed, False), carried=True),
    SHARP: HoldPolicy(partial(_decayed, True), carried=True),
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


def track(seed: int, runs: int = 24) -> Study:
    """Twenty nodes follow a turning target."""
    scenario = replace(kind_of("target-tracking").defaults, seed=seed, rounds=3)
    return Study("TRACK", scenario, runs, 20, position_only=True)


def motor(seed: int, runs: int = 12) -> Study:
    """Eight nodes on a ring watch a motor's position."""
    default = kind_of("dc-motor-position").defaults
    scenario = replace(default, seed=seed, rounds=3, control="truth")
    return Study("MOTOR", scenario, runs, 60, position_only=False)


def measure(tracking: Study, turning: Study) -> Occupancy:
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

        def tell(cell: Cell) -> Cell:
            done(next(counted))
            return cell

        benches = {study.name: Bench(study) for study in (tracking, turning)}
        filled = [
            _table(benches[study.name], rows, rounds, full=full, tell=tell)
            for study, rows, rounds, full in tables
        ]
        on_track = benches[tracking.name]
        by_schedule = {
            (variant, schedule, occupancy): tell(on_track.cell(variant, occupancy, 3, schedule))
            for variant, schedule, occupancy in schedules
        }
    return Occupancy(
        *filled,
        schedules=by_schedule,
        central_rmse_m=on_track.central_rmse,
        central_anees=on_track.central_anees,
        track_slem=second_eigenvalue_modulus(on_track.weights),
    )


class Bench:
    """A study with its runs, on which variants are tried."""

    def __init__(self, study: Study) -> None:
        setup = prepare(study.scenario)
        self.study = study
        self.weights = np.zeros((study.scenario.nodes,) * 2)
        for node, heard in enumerate(setup.neighbours):
            self.weights[node, [node, *heard]] = setup.weights[node]
        self.runs = simulate(study.scenario, range(study.runs))
        central = centralised(self.runs)
        errors = self._errors(central.mean)
        self.scale = self._scale(central)
        # Per run: what the network's squared errors are relative to.
        squared = (errors**2 * self.scale).sum(axis=-1).mean(axis=0)
        self.central_squared = squared if study.position_only else np.ones(study.runs)
        self.central_rmse = float(np.sqrt(squared.mean()))
        inverse_dimension = 1 / errors.shape[-1]
        self.central_anees = float(
            nees(errors, central.cov[study.first_step :]).mean() * inverse_dimension
        )

    def cell(self, variant: Variant, occupancy: float, rounds: int, schedule: str) -> Cell:
        """One variant at one occupancy."""
        scenario = replace(
            self.study.scenario,
            rounds=rounds,
            occupancy=occupancy,
            schedule="full" if occupancy == FULL else schedule,
        )
        wiring = wire(self.weights, rounds, build_schedule(scenario), HOLDS[variant.hold])
        states = self.runs.prior.mean.shape[-1]
        belief = estimate(self.runs, wiring, averaging_of(variant.rule, scenario.nodes, states))
        return self._score(belief)

    def _errors(self, mean: Array) -> Array:
        truth = self.runs.truth[self.study.first_step :]
        return mean[self.study.first_step :] - truth.reshape(
            *truth.shape[:2], *(1,) * (mean.ndim - 3), -1
        )

    def _scale(self, central: Gaussian) -> Array:
        """What squared errors of the states are multiplied by, (n,)."""
        n = central.mean.shape[-1]
        if self.study.position_only:
            return np.isin(np.arange(n), kind_of(self.study.scenario.name).score.states) * 1.0
        return 1 / (n * np.diagonal(central.cov[-1, 0]))

    def _score(self, belief: Gaussian) -> Cell:
        mean, cov = belief.mean[self.study.first_step :], belief.cov[self.study.first_step :]
        errors = self._errors(belief.mean)
        spread = mean - mean.mean(axis=2, keepdims=True)
        squared = (errors**2 * self.scale).sum(axis=-1).mean(axis=(0, 2))
        apart = (spread**2 * self.scale).sum(axis=-1).mean(axis=(0, 2))
        consistency = nees(errors, cov).mean(axis=(0, 1)) / errors.shape[-1]
        low, high = bootstrap(squared, self.central_squared)
        reference = self.central_squared.mean()
        return Cell(
            float(np.sqrt(squared.mean() / reference)),
            low,
            high,
            float(np.sqrt(apart.mean() / reference)),
            float(consistency.mean()),
            float(consistency.max()),
        )


def bootstrap(squared: Array, reference: Array) -> tuple[float, float]:
    """The 95 % interval of the root of mean(squared) / mean(reference), both (runs,) and paired."""
    generator = np.random.default_rng(0)
    chosen = generator.integers(len(squared), size=(RESAMPLES, len(squared)))
    ratios = np.sqrt(squared[chosen].mean(axis=1) / reference[chosen].mean(axis=1))
    low, high = np.quantile(ratios, [0.025, 0.975])
    return float(low), float(high)


def _cells(variants: list[Variant], full: bool) -> Iterator[tuple[Variant, float]]:
    """Variants and occupancies; at full occupancy all variants of a rule are one, but for det."""
    for variant in variants:
        if full and _differs_when_full(variant, variants):
            yield variant, FULL
        yield from ((variant, occupancy) for occupancy in LIMITED)


def _differs_when_full(variant: Variant, variants: list[Variant]) -> bool:
    """The first of its rule, and whoever weighs by determinant."""
    return variant.hold == SHARP or next(v for v in variants if v.rule == variant.rule) == variant


def _table(
    bench: Bench, variants: list[Variant], rounds: int, *, full: bool, tell: Callable[[Cell], Cell]
) -> Table:
    return {
        (variant, occupancy): tell(bench.cell(variant, occupancy, rounds, "hybrid"))
        for variant, occupancy in _cells(variants, full)
    }
