"""Labelled measurements beside consensus on beliefs, on TRACK: the jobs, and what becomes of them.

Every form hears the same noise in the same run, so that ratios are of pairs.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.papers.kit.side_by_side import side_by_side
from concord.results.bus.bus_report import wire_per_step
from concord.results.bus.sent_shares import SentShares
from concord.results.figures.intervals import Interval, mean_t, ratio_t
from concord.results.records.record_spread import figures_of
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.build import build_bus
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare, share_bytes
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import COV, READINGS, simulate

OCCUPANCIES = (1.0, 0.5, 0.25, 0.1)


class Form(NamedTuple):
    """A rule with its options, by the name it has in a table."""

    name: str
    options: dict[str, Any]

    @property
    def labelled(self) -> bool:
        """Whether measurements travel."""
        return self.options["rule"] == "labelled"


# The study's arbiter knows all bids.
_IDEAL = {"arbiter": "wtod"}
_NEAR = {"rule": "labelled", "payload_bytes": 254, **_IDEAL}
_FAR = {"schedule": "hybrid", "number": "float32", **_IDEAL}
FORMS = (
    Form("labelled, hybrid", {**_NEAR, "schedule": "hybrid"}),
    Form("labelled, hybrid-leaves", {**_NEAR, "schedule": "hybrid-leaves"}),
    Form("labelled, dynamic", {**_NEAR, "schedule": "dynamic"}),
    Form("labelled relay, hybrid", {**_NEAR, "schedule": "hybrid", "relay": True}),
    Form("labelled relay, dynamic", {**_NEAR, "schedule": "dynamic", "relay": True}),
    Form("ci", {"rule": "ci", **_FAR}),
    Form("hcmci", {"rule": "hcmci", **_FAR}),
    Form("wac", {"rule": "wac", **_FAR}),
)


class StudyJob(NamedTuple):
    """Runs 0, 1, ... of one cell of the table."""

    form: Form
    occupancy: float
    seed: int
    runs: int


class RunOutcome(NamedTuple):
    """Figures of one run.

    Mean squared errors are those of the network and of the centralised filter. Mean NEES over
    dimension is given for each node (N,) and for the centralised filter. Per step: the bytes sent,
    the bytes of all frames with headers and padding, and the microseconds of all frames. The last
    two exist for labelled shares only.
    """

    squared: float
    squared_centralised: float
    consistency: np.ndarray
    consistency_centralised: float
    said_bytes: float
    wire_bytes: float
    wire_us: float
    coverage: float
    checkpoint_share: float


class FormCell(NamedTuple):
    """A form at an occupancy, over all runs.

    `ratio` is the RMSE over that of the centralised filter, `ratio_low` and `ratio_high` are the
    ends of its interval. `excess` is the worst node's ANEES minus the centralised one,
    `excess_half_width` that of its interval.
    """

    ratio: float
    ratio_low: float
    ratio_high: float
    anees: float
    excess: float
    excess_half_width: float
    said_bytes: float
    wire_bytes: float
    wire_us: float
    coverage: float
    checkpoint_share: float

    @property
    def error(self) -> Interval:
        """The ratio with its interval."""
        return Interval(self.ratio, self.ratio_low, self.ratio_high)


def outcomes(job: StudyJob) -> list[RunOutcome]:
    """Return the figures of each run of a cell."""
    options = scenario_of(
        scenario="target-tracking", nodes=20, seed=job.seed, occupancy=job.occupancy,
        **job.form.options,
    )  # fmt: skip
    setup = prepare(options)
    histories = simulate(setup, range(job.runs), keep=(READINGS, COV))
    assert histories.readings is not None and histories.cov is not None
    central = centralised_of_runs(setup, range(job.runs), histories.readings, histories.control)
    central = Gaussian(central.mean[:, :, None], central.cov[:, :, None])
    network = Gaussian(histories.mean, histories.cov)
    scores = (_scored(setup, histories.truth, belief) for belief in (network, central))
    (squared, consistency), (squared_central, consistency_central) = scores
    bus = build_bus(setup)
    found = []
    for run in range(job.runs):
        spread = figures_of(histories.spreads[run]) if job.form.labelled else None
        sent = SentShares(histories.payload_bytes[run], histories.classes[run])
        shares = np.count_nonzero(sent.payload_bytes) * share_bytes(setup) / setup.scenario.steps
        found.append(
            RunOutcome(
                squared[run].mean(),
                squared_central[run].mean(),
                consistency[run],
                consistency_central[run].mean(),
                shares if spread is None else spread.body_bytes_per_step,
                *wire_per_step(bus, sent),
                np.nan if spread is None else spread.coverage,
                np.nan if spread is None else spread.checkpoint_share,
            )
        )
    return found


def cells(forms: Sequence[Form], seed: int, runs: int) -> Iterator[tuple[Form, float, FormCell]]:
    """All cells of the table, in order."""
    jobs = [StudyJob(form, part, seed, runs) for form in forms for part in OCCUPANCIES]
    for job, found in zip(jobs, side_by_side("errors and bytes", outcomes, jobs), strict=True):
        yield job.form, job.occupancy, cell(found)


def cell(outcomes: Sequence[RunOutcome]) -> FormCell:
    """From the runs of a cell, at least two."""
    squared = np.array([[o.squared, o.squared_centralised] for o in outcomes])
    consistency = np.array([o.consistency - o.consistency_centralised for o in outcomes])
    worst = int(consistency.mean(axis=0).argmax())
    excess = mean_t(consistency[:, worst])
    return FormCell(
        *ratio_t(squared[:, 0], squared[:, 1]),
        float(np.mean([o.consistency for o in outcomes])),
        excess.value,
        excess.high - excess.value,
        *(
            float(np.mean([getattr(o, name) for o in outcomes]))
            for name in ("said_bytes", "wire_bytes", "wire_us", "coverage", "checkpoint_share")
        ),
    )


def _scored(setup: Setup, truth: np.ndarray, belief: Gaussian) -> tuple[np.ndarray, np.ndarray]:
    """Mean squared error and mean NEES over dimension of each node (R, N) of beliefs (R, steps, N,
    n), against the truth (R, steps, n)."""
    score = definition_of(setup.scenario).score
    scored = slice(score.first_step, None)
    errors = belief.mean[:, scored] - truth[:, scored, None]
    states = list(score.nees_states)
    squared = (errors[..., list(score.states)] ** 2).sum(-1)
    values = nees(errors[..., states], belief.cov[:, scored][..., states, :][..., states])
    return squared.mean(1), values.mean(1) / len(states)


def ratio_text(ratio: Interval) -> str:
    """Return a ratio with its interval, for a table."""
    return f"{ratio.value:.3f} {ratio.spread('± ')}".rstrip()
