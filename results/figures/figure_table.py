"""The one table of figures: what each is, and how it is computed.

`concord run`, sweeps, designs, comparisons, reports, pictures and the page take figures from here,
under these names. A column more is one entry here, or in the table FIGURES of a feature
(`concord.entries`).
"""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from concord.entries import chosen, entries
from concord.filters.metrics import largest_of_known, mean_of_known

if TYPE_CHECKING:
    from concord.results.figures.run_view import RunView

Compute = Callable[["RunView"], np.ndarray]
Statistic = Literal["mean", "rms"]


class Figure(NamedTuple):
    """A figure of R runs, each of which has one value.

    Attributes:
        dimensions: its axes.
        units: "score" is the unit of the scenario's error, "state" that of each state.
        meaning: in words.
        compute: its values, by these dimensions.
        statistic: what stands for many runs: their mean, or the root of the mean of their squares.
        is_swept: whether sweeps keep it. Nodes alone would double their time.
    """

    dimensions: tuple[str, ...]
    units: str
    meaning: str
    compute: Compute
    statistic: Statistic = "mean"
    is_swept: bool = True


class Ratio(NamedTuple):
    """A figure that is the ratio of the root mean squares of two others, in the same runs."""

    one: str
    other: str
    meaning: str


COVERED = 0.95
_RUN, _STEP, _NODE = ("run",), ("run", "step"), ("run", "node")


def _within(view: "RunView") -> np.ndarray:
    """Whether the 95 % ellipsoid of an estimate holds the truth (R, S, N)."""
    # Only here: scipy takes longer to load than most commands take.
    from scipy.special import chdtri

    states = len(view.score.nees_states)
    nees, most = view.errors.nees, chdtri(states, 1 - COVERED) / states
    return np.where(np.isnan(nees), np.nan, nees <= most)


def _nis(view: "RunView") -> np.ndarray:
    """The mean over readings; above 1 they lie further from predictions than filters believe."""
    found = view.runs.innovations
    if found is None:
        return np.full(len(view.readings), np.nan)
    return view.mean(found.nis / np.where(found.entries > 0, found.entries, np.nan), (1, 2, 3))


_TRAFFIC_OF_NODES = {
    "sent": "frames that a node sent",
    "heard": "frames that it could use",
    "missed": "frames that were due and did not come",
    "rejected": "frames that it could not use",
}


def _counts(name: str, view: "RunView") -> np.ndarray:
    return view.counts(name)


def _alone(view: "RunView") -> np.ndarray:
    """The median over the nodes that estimate, and take a reading in a step that counts."""
    each = view.root(view.squares_alone, (1,))
    sees = np.array([
        np.logical_not(blind[counts]).any(axis=0)
        for blind, counts in zip(view.blind, view.counted, strict=True)
    ])  # fmt: skip
    believes = np.logical_not(np.isnan(each)) & view.runs.present.any(axis=1)
    known = believes & (sees | np.logical_not((sees & believes).any(axis=1, keepdims=True)))
    pairs = zip(each, known, strict=True)
    return np.array([np.median(row[there]) if there.any() else np.nan for row, there in pairs])


def _traffic(name: str) -> Compute:
    return lambda view: view.traffic[name]


def _total(name: str) -> Compute:
    return lambda view: view.counts(name).sum(axis=1)


def _of_extras(name: str, view: "RunView") -> np.ndarray:
    return view.of_extras.get(name, np.full(len(view.readings), np.nan))


def _of_features() -> dict[str, Figure]:
    """Figures of the features: dimensions, unit, meaning, and a function of the runs, or none for
    those of the feature's `RunExtras`; NaN for scenarios without them."""
    rows = {name: row for one in entries("FIGURES") for name, row in chosen("FIGURES", one).items()}
    return {
        name: Figure(row[0], row[1], row[2], row[3] if len(row) > 3 else partial(_of_extras, name))
        for name, row in rows.items()
    }


def _sets(measure: str, axes: tuple[int, ...], central: bool = False) -> Compute:
    """A measure of `SetsBesideTruth` over axes; NaN where estimates are no sets."""

    def compute(view: "RunView") -> np.ndarray:
        if view.sets is None:
            nodes = () if len(axes) == 2 or central else (view.setup.scenario.nodes,)
            return np.full((len(view.readings), *nodes), np.nan)
        return getattr(view.sets[central], measure)(axes)

    return compute


_NEAR = "within the time of the scenario after a reading by any node"
FIGURES: dict[str, Figure] = {
    "rmse": Figure(
        _RUN, "score", "root mean square error of all nodes over the scored steps",
        lambda view: view.root(view.squares, (1, 2)), "rms",
    ),
    "rmse_centralised": Figure(
        _RUN, "score", "the same of one filter that hears everything",
        lambda view: view.root(view.squares_centralised, (1,)), "rms",
    ),
    "rmse_alone": Figure(
        _RUN, "score", "the same of a node without neighbours: the median of those that see",
        _alone, "rms", is_swept=False,
    ),
    "rmse_blind": Figure(
        _RUN, "score", "the same of nodes in steps in which they read nothing",
        lambda view: view.root(np.where(view.blind, view.squares, np.nan), (1, 2)), "rms",
    ),
    "rmse_worst_node": Figure(
        _RUN, "score", "the same of the worst node of the run",
        lambda view: largest_of_known(view.root(view.squares, (1,))), "rms",
    ),
    "rmse_smoothed": Figure(
        _RUN, "score", "error of the states of --smooth-steps steps ago",
        lambda view: view.smoothed_last(central=False), "rms",
    ),
    "rmse_smoothed_centralised": Figure(
        _RUN, "score", "of a smoother that hears everything",
        lambda view: view.smoothed_last(central=True), "rms",
    ),
    "rmse_near_centralised": Figure(
        _RUN, "score", f"error of the filter that hears everything {_NEAR}",
        lambda view: view.root(np.where(view.near, view.squares_centralised, np.nan), (1,)),
        "rms", is_swept=False,
    ),
    "disagreement": Figure(
        _RUN, "score", "root mean square distance from the nodes' average",
        lambda view: view.root(view.spreads, (1, 2)), "rms",
    ),
    "from_centralised": Figure(
        _RUN, "score", "root mean square distance from the filter that hears everything",
        lambda view: view.root(view.squares_from_centralised, (1, 2)), "rms",
    ),
    "anees": Figure(
        _RUN, "1", "normalised squared error per state; above 1 is overconfident",
        lambda view: view.mean(view.errors.nees, (1, 2)),
    ),
    "anees_centralised": Figure(
        _RUN, "1", "the same of one filter that hears everything",
        lambda view: view.mean(view.errors.nees_centre, (1,)),
    ),
    "nis": Figure(
        _RUN, "1", "normalised squared innovation per entry of the nodes' own readings; NaN where "
        "runs kept none", _nis,
    ),
    "coverage": Figure(
        _RUN, "1", "share of the estimates whose 95 % ellipsoid holds the truth",
        lambda view: view.mean(_within(view), (1, 2)),
    ),
    "sets": Figure(
        _RUN, "1", "number of sets beside a known truth", _sets("number", (1, 2)), is_swept=False
    ),
    "sets_outside": Figure(
        _RUN, "1", "number of sets that do not hold the truth", _sets("outside", (1, 2))
    ),
    "sets_outside_centralised": Figure(
        _RUN, "1", "the same of one filter that hears everything",
        _sets("outside", (1,), central=True), is_swept=False,
    ),
    "set_half_width_centralised": Figure(
        _RUN, "state", "half-width of the sets of one filter that hears everything",
        _sets("half_width", (1,), central=True), is_swept=False,
    ),
    "set_largest_centralised": Figure(
        _RUN, "1", "largest e' P^-1 e of these sets", _sets("largest", (1,), central=True),
        is_swept=False,
    ),
    "set_largest": Figure(
        _RUN, "1", "largest e' P^-1 e of a set; 1 is its edge", _sets("largest", (1, 2))
    ),
    "set_half_width": Figure(
        _RUN, "state", "mean of the half-width sqrt(tr P) of a set", _sets("half_width", (1, 2))
    ),
    "failed": Figure(
        _RUN, "1", "1 for a run that failed: filters, fusions, truth, or no readings",
        lambda view: view.failed.astype(float),
    ),
    "published": Figure(
        _RUN, "1", "share of the nodes that publish in a communication cycle",
        _traffic("published"),
    ),
    "shares_sent": Figure(_RUN, "1", "frames of shares sent", _total("sent"), is_swept=False),
    "shares_missed": Figure(
        _RUN, "1", "frames that were due and did not come", _total("missed"), is_swept=False
    ),
    "bytes_per_step": Figure(
        _RUN, "B", "bytes of all frames of a step, with headers and padding",
        _traffic("bytes_per_step"),
    ),
    "energy_per_step": Figure(
        _RUN, "mJ", "first-order radio model, senders and hearers", _traffic("energy_per_step")
    ),
    "bus_load": Figure(
        _RUN, "1", "share of a cycle with a round in which there are frames", _traffic("bus_load")
    ),
    "bus_load_all": Figure(
        _RUN, "1", "the same over all cycles of the bus", _traffic("bus_load_all")
    ),
    "bus_time_us": Figure(
        _RUN, "us", "time of a step in which the channel carries frames", _traffic("bus_time_us")
    ),
    "delay_us": Figure(
        _RUN, "us", "from the measurement to the end of the last share of a step",
        _traffic("delay_us"),
    ),
    "share_age": Figure(
        _RUN, "cycles", "mean age of the neighbours' shares behind an estimate",
        _traffic("share_age"),
    ),
    "share_age_max": Figure(_RUN, "cycles", "the oldest of them", _traffic("share_age_max")),
    "share_age_all": Figure(
        _RUN, "cycles", "the mean age in all cycles of the bus", _traffic("share_age_all")
    ),
    "never_heard": Figure(
        _RUN, "1", "share of the neighbours of which nothing is held", _traffic("never_heard")
    ),
    "rmse_state": Figure(
        (*_RUN, "state"), "state", "root mean square error of each state",
        lambda view: view.root((view.runs.mean - view.runs.truth[:, :, None]) ** 2, (1, 2)), "rms",
    ),
    "rmse_node": Figure(
        _NODE, "score", "root mean square error of each node",
        lambda view: view.root(view.squares, (1,)), "rms",
    ),
    "rmse_alone_node": Figure(
        _NODE, "score", "the same without neighbours",
        lambda view: view.root(view.squares_alone, (1,)), "rms", is_swept=False,
    ),
    "rmse_near_node": Figure(
        _NODE, "score", f"error of each node {_NEAR}",
        lambda view: view.root(np.where(view.near[..., None], view.squares, np.nan), (1,)),
        "rms", is_swept=False,
    ),
    "anees_node": Figure(
        _NODE, "1", "normalised squared error per state of each node",
        lambda view: view.mean(view.errors.nees, (1,)), is_swept=False,
    ),
    "sets_outside_node": Figure(
        _NODE, "1", "number of sets of each node that do not hold the truth",
        _sets("outside", (1,)), is_swept=False,
    ),
    "set_largest_node": Figure(
        _NODE, "1", "largest e' P^-1 e of each node", _sets("largest", (1,)), is_swept=False
    ),
    "set_half_width_node": Figure(
        _NODE, "state", "mean half-width of each node's sets", _sets("half_width", (1,)),
        is_swept=False,
    ),
    **{
        f"{name}_node": Figure(_NODE, "1", meaning, partial(_counts, name), is_swept=False)
        for name, meaning in _TRAFFIC_OF_NODES.items()
    },
    "error": Figure(
        _STEP, "score", "root mean square error of all nodes at a step",
        lambda view: np.sqrt(mean_of_known(view.squares, (2,))), "rms",
    ),
    "error_centralised": Figure(
        _STEP, "score", "error of the filter that hears everything",
        lambda view: np.sqrt(view.squares_centralised), "rms",
    ),
    "spread": Figure(
        _STEP, "score", "root mean square distance from the nodes' average",
        lambda view: np.sqrt(mean_of_known(view.spreads, (2,))), "rms",
    ),
    "nees": Figure(
        _STEP, "1", "normalised squared error per state, mean over the nodes",
        lambda view: mean_of_known(view.errors.nees, (2,)),
    ),
    "bound": Figure(
        ("step",), "score", "posterior Cramer-Rao bound on the error",
        lambda view: np.sqrt(view.variances(view.frame.bound, view.score.states).sum(-1)), "rms",
    ),
    "bound_state": Figure(
        ("step", "state"), "state", "the same of each state",
        lambda view: np.sqrt(view.variances(view.frame.bound)), "rms",
    ),
    **_of_features(),
}  # fmt: skip
RATIOS = {
    "to_centralised": Ratio("rmse", "rmse_centralised", "error beside the filter that hears all"),
    "worst_node_to_centralised": Ratio(
        "rmse_worst_node", "rmse_centralised", "error of the worst node beside that filter"
    ),
    "blind_to_centralised": Ratio(
        "rmse_blind", "rmse_centralised", "error of steps without a reading beside that filter"
    ),
    "smoothed_to_centralised": Ratio(
        "rmse_smoothed", "rmse_smoothed_centralised", "smoothed error beside one smoother of all"
    ),
    "anees_to_centralised": Ratio("anees", "anees_centralised", "ANEES beside that filter"),
    "alone_to_network": Ratio("rmse_alone", "rmse", "error of a node alone beside the network's"),
}
SWEPT = tuple(name for name, figure in FIGURES.items() if figure.is_swept)


def computed(view: "RunView", names: tuple[str, ...] = SWEPT) -> dict[str, np.ndarray]:
    """Return the figures of these names, with their dimensions."""
    return {name: FIGURES[name].compute(view) for name in names}
