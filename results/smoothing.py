"""`--smooth`: a run's states given all its readings, as a reference where no truth is known.

One smoother hears every sensor, with the filter of the scenario. Its estimate of a step uses the
readings before and after it, so that its error is smaller than that of any filter. The reference is
no truth: errors that all its sensors or its model share are in it as well.
"""

from pathlib import Path

import msgspec
import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import mean_of_known, rmse
from concord.results.figures.network_errors import outside_steps
from concord.results.folder import Description
from concord.results.records.netcdf_file import Arrays, state_coordinates, write_arrays
from concord.results.records.trace import Trace
from concord.scenarios.baselines import (
    centralised,
    centralised_smoothed,
    filters_step_by_step,
)
from concord.scenarios.catalogue import beside_truth, definition_of, scored_nees
from concord.scenarios.filter_table.filters import models_of
from concord.scenarios.setup import Setup

SMOOTHED = "smoothed.nc"


class SmoothingFigures(msgspec.Struct, frozen=True):
    """Errors of the smoothed reference, and distances of the nodes from it, over scored steps.

    `rmse`, `rmse_filtered` and `anees` are NaN where no truth is known. `rmse_filtered` is that of
    the filter with the same readings. `distance` has, for each node, the root mean square of the
    difference of its estimate from the reference, over the scored states.
    """

    rmse: float
    rmse_filtered: float
    anees: float
    distance: list[float]


class Smoothed(msgspec.Struct, frozen=True):
    """Beliefs (steps, n) of one filter that hears everything, and of its smoother."""

    filtered: Gaussian
    smoothed: Gaussian


def check_smoothing(setup: Setup) -> None:
    """Refuse a network whose estimates no smoother can go back through.

    Raises:
        ValueError: naming the option, what is in its way, and the cure.
    """
    definition, choice = definition_of(setup.scenario), setup.scenario.filter
    if models_of(choice) > 1:
        raise ValueError(
            f"--smooth with --filter {choice.name}: the smoother has one model; leave it out, or "
            "use --filter ukf"
        )
    if definition.wirings or not filters_step_by_step(setup):
        raise ValueError(
            f"--smooth with --rule {setup.scenario.rule.name} on {setup.scenario.name}: the filter "
            "that hears everything keeps no beliefs of each step; leave it out, or use a rule such "
            "as ci"
        )


def smoothed_of(setup: Setup, trace: Trace) -> Smoothed:
    """The filter that hears everything in a run, and its smoother."""
    filtered = centralised(setup, trace.readings, trace.control)
    smoothed = centralised_smoothed(setup, filtered, trace.control)
    return Smoothed(
        *(
            Gaussian(beside_truth(setup.scenario, one.mean, trace.truth), one.cov)
            for one in (filtered, smoothed)
        )
    )


def smoothing_figures(setup: Setup, trace: Trace, found: Smoothed, first: int) -> SmoothingFigures:
    """The figures of a reference from a step on."""
    score = definition_of(setup.scenario).score
    states = list(score.states)
    of_smoothed, of_filtered = (
        (one.mean - trace.truth)[first:][:, states] for one in (found.smoothed, found.filtered)
    )
    away = (trace.mean - found.smoothed.mean[:, None])[first:][..., states]
    errors, cov = found.smoothed.mean - trace.truth, found.smoothed.cov
    outside = outside_steps(setup, found.filtered.mean[None])[0]
    nees = np.where(outside, np.nan, scored_nees(setup.scenario, errors, cov))
    consistency = mean_of_known(nees[first:], (0,))
    return SmoothingFigures(
        rmse=float(rmse(of_smoothed, (0,))),
        rmse_filtered=float(rmse(of_filtered, (0,))),
        anees=float(consistency / len(score.nees_states)),
        distance=rmse(away, (0,)).tolist(),
    )


def write_smoothed(folder: Path, description: Description, found: Smoothed) -> None:
    """Write smoothed.nc: filtered and smoothed beliefs of each step, side by side."""
    setup = description.setup
    variables = {}
    for name, belief in (("filtered", found.filtered), ("smoothed", found.smoothed)):
        variables[f"{name}_mean"] = (("step", "state"), belief.mean)
        variables[f"{name}_cov"] = (("step", "state", "other_state"), belief.cov)
    coordinates = state_coordinates(setup, len(found.filtered.mean))
    attributes = {
        "title": f"concord run {description.run}, a filter that hears everything and its smoother",
        "scenario": msgspec.json.encode(setup.scenario).decode(),
        "filter": setup.scenario.filter.name,
    }
    write_arrays(Arrays(variables, coordinates, attributes), folder / SMOOTHED)


def smoothing_line(figures: SmoothingFigures, unit: str) -> str:
    """The figures in words."""
    distances = ", ".join(f"{one:.4g}" for one in figures.distance)
    text = f"smoothed ({SMOOTHED}): nodes differ from it by {distances} {unit}"
    if np.isnan(figures.rmse):
        return text
    return (
        f"{text}; its error is {figures.rmse:.4g} {unit}, that of its filter "
        f"{figures.rmse_filtered:.4g}, ANEES {figures.anees:.4g}"
    )
