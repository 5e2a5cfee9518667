"""Drawn plants of a user's own, through `cc.simulate` with rules that take turns.

Each number is a plant: 1 to 30 states of scales 1e-4 to 1e6 and origins up to 1e7, with rates of
noise, angles, and readings that are missing half of the time. The part prints how many are
overconfident, not numbers, or refused, and why.
"""

import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import tyro

import concord as cc
from concord.results.figures.intervals import mean_t
from concord.studies.progress import progress

RULES = ("ci", "sharp-ci", "hcmci", "icf", "labelled")
CONFIDENCE = 0.999
STEPS, FIRST_SCORED = 30, 10


@dataclass(frozen=True, kw_only=True)
class PlantOptions:
    """Which plants."""

    first: int = 1
    """Number of the first plant."""
    plants: int = 100
    """How many plants."""
    runs: int = 8
    """Runs of each plant; those that are overconfident are run again, eight times as often."""
    rules: tuple[str, ...] = RULES
    """Rules, which take turns."""
    bus: str = "ideal"
    """Bus of the networks."""


class DrawnPlant(NamedTuple):
    """A drawn scenario, and a description of it."""

    scenario: cc.Scenario
    words: str


class Verdict(NamedTuple):
    """The outcome of a plant under a rule: a kind, and the figures or the reason behind it."""

    kind: str
    why: str = ""


def drawn_plant(number: int) -> DrawnPlant:
    """The plant of a number."""
    rng = np.random.default_rng(number)
    n, turning = int(rng.integers(1, 31)), bool(rng.random() < 0.4)
    spread, shift = rng.choice([0, 2, 5]), rng.choice([0, 0, 1e3, 1e7])
    scale = 10 ** rng.uniform(max(-4, -spread), min(6, spread), n)
    origin = shift * rng.uniform(-1, 1, n) * np.where(rng.random() < 0.5, scale, 1.0)
    matrix = rng.standard_normal((n, n))
    matrix *= rng.uniform(0.7, 0.99) / np.abs(np.linalg.eigvals(matrix)).max()
    drive, bend = 10 ** rng.uniform(-4, 0), float(rng.choice([0.0, 0.05]))
    turn = 10 ** rng.uniform(-2, 0.3)

    def move(x: np.ndarray) -> np.ndarray:
        z = (x[..., :n] - origin) / scale
        z = z @ matrix.T + bend * np.sin(z)
        after = origin + scale * z
        if not turning:
            return after
        phase = (x[..., n:] + turn + np.pi) % (2 * np.pi) - np.pi
        return np.concatenate((after, phase), axis=-1)

    angles, phase = (n,) * turning, [1e-4] * turning
    plant = cc.OwnPlant(
        f=move,
        Q=[*(drive * scale**2), *phase],
        mean=[*origin, *[3.0] * turning],
        cov=[*scale**2, *[0.01] * turning],
        angles=angles,
    )
    sensors = [*_sensors(rng, n, origin, scale, turning), None]
    scenario = cc.own_scenario(
        plant, sensors, graph="complete", steps=STEPS, first_scored_step=FIRST_SCORED
    )
    words = f"{n} states, shift {shift:g}, scales 1e{spread}, drive {drive:.1g}, turning {turning}"
    return DrawnPlant(scenario, words)


def _sensors(
    rng: np.random.Generator, n: int, origin: np.ndarray, scale: np.ndarray, turning: bool
) -> Iterator[cc.OwnSensor]:
    """Sensors of one to three states; a turning plant's first reads the phase, and the second
    nothing for half of a turn."""
    if turning:
        yield cc.OwnSensor(h=lambda x: x[..., n:], R=10 ** rng.uniform(-4, -1), angles=(0,))
    for number in range(int(rng.integers(2, 5))):
        rows = rng.choice(n, min(n, int(rng.integers(1, 4))), replace=False)
        missing = turning and number == 0

        def see(x: np.ndarray, rows: np.ndarray = rows, missing: bool = missing) -> np.ndarray:
            seen = x[..., rows]
            return np.where(np.cos(x[..., n:]) > 0, seen, np.nan) if missing else seen

        yield cc.OwnSensor(h=see, R=10 ** rng.uniform(-6, 1) * scale[rows] ** 2)


def tried(drawn: DrawnPlant, rule: str, bus: str, runs: int) -> Verdict:
    """Run a plant under a rule on a bus."""
    try:
        found = cc.simulate(drawn.scenario.with_(rule=rule, bus=bus), runs=runs)
    except ValueError as refusal:
        return Verdict("refused", re.sub(r"-?\d[\d.e+-]*", "#", str(refusal)))
    nees = found["nees"].to_numpy()[:, FIRST_SCORED:] / found.sizes["state"]
    if not np.isfinite(nees).all():
        return Verdict("NaN", f"{np.isnan(nees).mean():.1%} of the NEES")
    anees = mean_t(nees.mean(axis=(1, 2)), CONFIDENCE)
    kind = "overconfident" if anees.low > 1 else "cautious" if anees.high < 1 else "consistent"
    return Verdict(kind, f"ANEES {anees.value:.3g} ({anees.low:.3g} to {anees.high:.3g})")


def plants(output: Annotated[PlantOptions, tyro.conf.arg(name="")]) -> None:
    """Run drawn plants; exit code 1 where one is overconfident or no number."""
    kinds: dict[str, Counter[str]] = {rule: Counter() for rule in output.rules}
    reasons: Counter[str] = Counter()
    numbers = range(output.first, output.first + output.plants)
    with progress("plants", output.plants, as_json=False) as on_plant:
        for done, number in enumerate(numbers, start=1):
            try:
                drawn = drawn_plant(number)
            except ValueError as refusal:
                reasons[re.sub(r"-?\d[\d.e+-]*", "#", str(refusal))] += 1
                continue
            rule = output.rules[number % len(output.rules)]
            verdict = tried(drawn, rule, output.bus, output.runs)
            if verdict.kind == "overconfident":
                # One sound plant in two thousand is so by chance.
                sys.stdout.write(f"plant {number}, {rule}: {verdict.why}; again\n")
                verdict = tried(drawn, rule, output.bus, 8 * output.runs)
            kinds[rule][verdict.kind] += 1
            if verdict.kind == "refused":
                reasons[f"{rule}: {verdict.why}"] += 1
            elif verdict.kind in ("overconfident", "NaN"):
                sys.stdout.write(f"plant {number}, {rule}: {verdict.why}; {drawn.words}\n")
            on_plant(done)
    for rule, counted in kinds.items():
        told = ", ".join(f"{count} {kind}" for kind, count in counted.most_common())
        sys.stdout.write(f"{rule}: {told}\n")
    for reason, count in reasons.most_common():
        sys.stdout.write(f"{count} refused: {reason}\n")
    if any(counted["overconfident"] + counted["NaN"] for counted in kinds.values()):
        sys.exit(1)
