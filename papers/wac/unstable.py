"""Where the weighted average fails: an unstable plant that most nodes do not see.

A scalar plant F, a ring of eight, m nodes that see and 8 - m that are blind. With D = diag(0 where
a node sees, 1 where it is blind) the mean diverges if |F| rho(Pi^L D) > 1, the covariance if
F^2 rho(Pi^L D) > 1. Both are tried here against the exact propagation of 400 steps.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from concord.papers.kit.judging import Check, below
from concord.papers.kit.report import Section, markdown_table
from concord.studies.exact.averaged_errors import LinearNetwork, Moments, propagate
from concord.studies.exact.averaged_rules import RULES
from concord.topology.graphs import ring
from concord.topology.weights import metropolis

NODES = 8
FACTORS, SEEING, ROUNDS = (1.1, 1.2), (1, 2), (1, 5, 20)
STEPS = 400
VARIANCE = 0.01  # of the process per step, and of each measurement
GROWTH = 10.0  # over the second half of the steps: more is divergence


class UnstableOutcome(NamedTuple):
    """One network: the two radii of the condition, and what became of it after STEPS.

    *_rms: root mean square error over the nodes; *_variance: largest variance that a node reports.
    """

    factor: float
    seeing: int
    rounds: int
    mean_radius: float
    cov_radius: float
    wac_rms: float
    wac_rms_growth: float
    wac_variance: float
    wac_variance_growth: float
    ci_rms: float


def measure() -> list[UnstableOutcome]:
    """All twelve networks."""
    return [_try(*choice) for choice in product(FACTORS, SEEING, ROUNDS)]


def checks_of(outcomes: list[UnstableOutcome]) -> list[Check]:
    """The condition tells what happens, and covariance intersection stays bounded."""
    checks = []
    for o in outcomes:
        name = f"unstable plant F = {o.factor}, {o.seeing} seeing, {o.rounds} rounds: WAC"
        said, seen = (
            f"mean {_word(mean)}, covariance {_word(cov)}"
            for mean, cov in (
                (o.mean_radius > 1, o.cov_radius > 1),
                (o.wac_rms_growth > GROWTH, o.wac_variance_growth > GROWTH),
            )
        )
        checks.append(Check(name, said, seen, said == seen))
    worst = max(o.ci_rms for o in outcomes)
    return [*checks, below("unstable plants: largest RMSE of CI", worst, 0.5)]


def _word(diverges: bool) -> str:
    return "diverges" if diverges else "stays"


def section(place: int, outcomes: list[UnstableOutcome]) -> Section:
    """The table of the twelve."""
    head = (
        "F", "seeing", "L", "|F| rho(Π^L D)", "F² rho(Π^L D)", "WAC RMSE", "WAC largest P",
        "CI RMSE",
    )  # fmt: skip
    rows = [
        (
            f"{o.factor}", f"{o.seeing}", f"{o.rounds}", f"{o.mean_radius:.3f}",
            f"{o.cov_radius:.3f}", f"{o.wac_rms:.3g}", f"{o.wac_variance:.2g}", f"{o.ci_rms:.3g}",
        )
        for o in outcomes
    ]  # fmt: skip
    text = (
        f"Ring of {NODES}, scalar plant x⁺ = F x + w, process and measurement variance {VARIANCE}, "
        f"{STEPS} steps, exact. The paper's rule gives blind nodes their vote for ever; covariance "
        "intersection takes it from them as their covariance grows.\n\n"
    )
    data = {"outcomes": [o._asdict() for o in outcomes]}
    title = "The weighted average on an unstable plant"
    return Section(place, title, text + markdown_table(head, rows), checks_of(outcomes), data=data)


def _try(factor: float, seeing: int, rounds: int) -> UnstableOutcome:
    averaging = np.linalg.matrix_power(metropolis(ring(NODES)).toarray(), rounds)
    blind = np.diag(np.arange(NODES) >= seeing).astype(float)
    radius = float(np.abs(np.linalg.eigvals(averaging @ blind)).max())
    information = np.where(np.arange(NODES) < seeing, 1 / VARIANCE, 0.0)[:, None, None]
    network = LinearNetwork(
        np.array([[factor]]), np.array([[VARIANCE]]), information, np.array([[1.0]])
    )
    moments = list(propagate(network, RULES["wac"], averaging, STEPS))
    halfway, end = moments[STEPS // 2 - 1], moments[-1]
    *_, calm = propagate(network, RULES["ci"], averaging, STEPS)
    return UnstableOutcome(
        factor,
        seeing,
        rounds,
        factor * radius,
        factor**2 * radius,
        _rms(end),
        _rms(end) / _rms(halfway),
        float(end.reported.max()),
        float(end.reported.max() / halfway.reported.max()),
        _rms(calm),
    )


def _rms(moments: Moments) -> float:
    return float(np.sqrt(np.diag(moments.errors).mean()))
