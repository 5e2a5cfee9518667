"""Table of the figures of a Monte Carlo: dimensions, unit and meaning of each."""

from typing import NamedTuple

from concord.entries import chosen, entries


class Figure(NamedTuple):
    """Dimensions and unit of a variable ("score": the unit of the scenario's error)."""

    dimensions: tuple[str, ...]
    units: str
    meaning: str


_RUN, _STEP, _NODE = ("run",), ("run", "step"), ("run", "node")
OF_FEATURES = {
    name: Figure(*row) for one in entries("FIGURES") for name, row in chosen("FIGURES", one).items()
}
"""Figures of the features (`concord.entries`); NaN for scenarios without them."""
FIGURES = {
    "rmse": Figure(_RUN, "score", "root mean square error of all nodes over the scored steps"),
    "rmse_centralised": Figure(_RUN, "score", "the same of one filter that hears everything"),
    "rmse_blind": Figure(_RUN, "score", "the same of nodes in steps in which they read nothing"),
    "rmse_worst_node": Figure(_RUN, "score", "the same of the worst node of the run"),
    "rmse_smoothed": Figure(_RUN, "score", "error of the states of --smooth-steps steps ago"),
    "rmse_smoothed_centralised": Figure(_RUN, "score", "of a smoother that hears everything"),
    **OF_FEATURES,
    "disagreement": Figure(_RUN, "score", "root mean square distance from the nodes' average"),
    "anees": Figure(_RUN, "1", "normalised squared error per state; above 1 is overconfident"),
    "anees_centralised": Figure(_RUN, "1", "the same of one filter that hears everything"),
    "coverage": Figure(_RUN, "1", "share of the estimates whose 95 % ellipsoid holds the truth"),
    "published": Figure(_RUN, "1", "share of the nodes that publish in a communication cycle"),
    "bytes_per_step": Figure(_RUN, "B", "bytes of all frames of a step, frame overhead included"),
    "energy_per_step": Figure(_RUN, "mJ", "first-order radio model, senders and hearers"),
    "bus_load": Figure(_RUN, "1", "share of a cycle with a round in which there are frames"),
    "bus_load_all": Figure(_RUN, "1", "the same over all cycles of the bus"),
    "bus_time_us": Figure(_RUN, "us", "time of a step in which the channel carries frames"),
    "delay_us": Figure(_RUN, "us", "from the measurement to the end of the last share of a step"),
    "share_age": Figure(_RUN, "cycles", "mean age of the neighbours' shares behind an estimate"),
    "share_age_max": Figure(_RUN, "cycles", "the oldest of them"),
    "share_age_all": Figure(_RUN, "cycles", "the mean age in all cycles of the bus"),
    "never_heard": Figure(_RUN, "1", "share of the neighbours of whom nothing is held"),
    "rmse_state": Figure((*_RUN, "state"), "state", "root mean square error of each state"),
    "rmse_node": Figure(_NODE, "score", "root mean square error of each node"),
    "error": Figure(_STEP, "score", "root mean square error of all nodes at a step"),
    "error_centralised": Figure(_STEP, "score", "error of the filter that hears everything"),
    "spread": Figure(_STEP, "score", "root mean square distance from the nodes' average"),
    "nees": Figure(_STEP, "1", "normalised squared error per state, mean over the nodes"),
    "bound": Figure(("step",), "score", "posterior Cramer-Rao bound on the error"),
    "bound_state": Figure(("step", "state"), "state", "the same of each state"),
}
