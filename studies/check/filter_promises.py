"""Promises of a filter of the nodes: a value with `predict` and `update`."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from concord.filters.filter import Filter, begun, moments
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model
from concord.filters.update import Update
from concord.scenarios.filter_table.filters import build_filter, entry_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.studies.check.filter_cases import FilterCase, draw_filter_case
from concord.studies.check.neighbourhoods import LANES, apart, at_lane
from concord.studies.check.promise import (
    Promise,
    PromiseResult,
    amount,
    covariance_fault,
    fault_of,
)
from concord.studies.check.rule_promises import AGREEMENT

# Of means in standard deviations, and of covariances in those of both states.
_ROUNDING = 1e-6
_CURVE = 0.2
_LINEAR, _UNITS = "linear", "units"


class CheckedFilter(NamedTuple):
    """A filter that is checked.

    Attributes:
        scenario: a small network with this filter.
        unclaimed: names of promises that the filter does not make.
        only_linear: the filter is for linear models alone.
    """

    scenario: Scenario
    unclaimed: tuple[str, ...]
    only_linear: bool

    def of(self, states: int) -> Filter:
        """The filter for so many states."""
        return _OfMoments(build_filter(self.scenario.filter, states))


class _OfMoments(NamedTuple):
    """A filter of beliefs that may be of several models, on plain ones."""

    filter: Filter

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        before = begun(self.filter, belief)
        return moments(self.filter, self.filter.predict(before, transition, noise_cov))

    def update(self, belief: Gaussian, *arguments: Any, **options: Any) -> Update:
        found = self.filter.update(begun(self.filter, belief), *arguments, **options)
        return found._replace(belief=moments(self.filter, found.belief))


def checked_filter(name: str, linear: bool) -> CheckedFilter:
    """Return a filter by its name or its place in a file.

    Raises:
        ValueError: there is no such filter.
    """
    entry = entry_of(scenario_of("oscillator", filter=name).filter)
    # Several models need a plant that turns, and a deviation that is in the unit of its turns.
    turns = entry.models > 1
    plant = "target-tracking" if turns else "oscillator"
    scenario = scenario_of(plant, filter=name, nodes=5, steps=12)
    prepare(scenario)
    unclaimed = (_LINEAR,) * (entry.robust or not linear) + (_UNITS,) * turns
    return CheckedFilter(scenario, unclaimed, entry.linear)


def _each_lane_has_its_own_result(checked: Filter, case: FilterCase) -> str:
    predicted, updated = case.predict(checked), case.update(checked).belief
    shapes = [np.shape(part) for one in (predicted, updated) for part in one]
    expected = [part.shape for part in case.belief]
    if shapes != 2 * expected:
        return f"beliefs of shapes {expected} come back as {shapes}"
    for lane in np.ndindex(LANES):
        before = at_lane(case.belief, lane)
        for what, alone, beside in (
            ("predict", case.predict(checked, before), predicted),
            ("update", case.update(checked, before, case.readings[lane]).belief, updated),
        ):
            if (off := apart(alone, at_lane(beside, lane))) > _ROUNDING:
                return (
                    f"{what}: lane {lane} of {LANES} differs {amount(off)} from the same lane alone"
                )
    return ""


def _failed_lanes_fail_alone(checked: Filter, case: FilterCase) -> str:
    others = np.arange(np.prod(LANES)).reshape(LANES) > 0
    before = case.predict(checked), case.update(checked).belief
    for what, value in (("NaN", np.nan), ("0", 0.0)):
        mean, cov = (part.copy() for part in case.belief)
        mean[0, 0], cov[0, 0] = value, value
        failed = Gaussian(mean, cov)
        after = case.predict(checked, failed), case.update(checked, failed).belief
        for name, one, other in zip(("predict", "update"), after, before, strict=True):
            if (off := apart(*(_lanes(b, others) for b in (one, other)))) > _ROUNDING:
                return f"{name}: with {what} in lane (0, 0), other lanes move {amount(off)}"
    return ""


def _missing_entries_say_nothing(checked: Filter, case: FilterCase) -> str:
    nothing = case.update(checked, readings=np.full_like(case.readings, np.nan)).belief
    if not _same_bits(nothing, case.belief):
        return "a lane with no reading does not keep its belief bit for bit"
    fewer = case.readings.copy()
    fewer[..., -1] = np.nan
    found = case.update(checked, readings=fewer).belief
    if fewer.shape[-1] == 1:
        return "" if _same_bits(found, case.belief) else "a lane with no reading is changed"
    cut = case._replace(readings=fewer[..., :-1], H=case.H[:-1], R=case.R[:-1, :-1])
    off = apart(found, cut.update(checked).belief)
    return "" if off <= _ROUNDING else f"an entry that is NaN moves the belief {amount(off)}"


def _gated_lanes_keep_their_belief(checked: Filter, case: FilterCase) -> str:
    plain = case.update(checked)
    squared = np.asarray(plain.normalised_innovation_squared)
    if squared.shape != LANES:
        return f"normalised_innovation_squared has shape {squared.shape}, and must have {LANES}"
    found = case.update(checked, gate=float(np.median(squared))).belief
    refused = squared > np.median(squared)
    if not _same_bits(_lanes(found, refused), _lanes(case.belief, refused)):
        return "a lane beyond the gate does not keep its belief bit for bit"
    if apart(_lanes(found, ~refused), _lanes(plain.belief, ~refused)) > _ROUNDING:
        return "a lane within the gate has another belief than without a gate"
    wild = case.readings.copy()
    wild[0, 0] = 1e8
    found = case.update(checked, readings=wild, gate=30.0).belief
    if not _same_bits(at_lane(found, (0, 0)), at_lane(case.belief, (0, 0))):
        return "a reading of 1e8 passes a gate of 30"
    return ""


def _results_are_covariances(checked: Filter, case: FilterCase) -> str:
    found = {"predict": case.predict(checked), "update": case.update(checked).belief}
    faults = {what: covariance_fault(*belief, 1e-9) for what, belief in found.items()}
    return next((f"{what}: {fault}" for what, fault in faults.items() if fault), "")


def _equals_the_kalman_filter(checked: Filter, case: FilterCase) -> str:
    (mean, cov), F, H = case.belief, case.F, case.H
    predicted = Gaussian(mean @ F.T, F @ cov @ F.T + case.Q)
    if (off := apart(case.predict(checked), predicted)) > _ROUNDING:
        return f"predict differs {amount(off)} from F x, F P F' + Q"
    information = np.linalg.inv(cov) + H.T @ np.linalg.inv(case.R) @ H
    after = np.linalg.inv(information)
    gain = after @ H.T @ np.linalg.inv(case.R)
    moved = np.einsum("...ij,...j->...i", gain, case.readings - mean @ H.T)
    if (off := apart(case.update(checked).belief, Gaussian(mean + moved, after))) > _ROUNDING:
        return f"update differs {amount(off)} from the Kalman filter"
    return ""


def _units_do_not_matter(checked: Filter, case: FilterCase) -> str:
    usual = case.predict(checked), case.update(checked).belief
    for what, one, other in zip(("predict", "update"), usual, case.in_units(checked), strict=True):
        if (off := apart(other, one)) > _ROUNDING:
            return f"{what}: other units of states and readings move the result {amount(off)}"
    return ""


def _nothing_is_remembered(checked: Filter, case: FilterCase) -> str:
    first = case.predict(checked), case.update(checked).belief
    copies = [part.copy() for part in case.belief]
    case.update(checked, first[0], case.readings + 1.0)
    again = case.predict(checked), case.update(checked).belief
    if not _same_bits(Gaussian(*copies), case.belief):
        return "the filter changes the belief that it is given"
    same = all(_same_bits(one, other) for one, other in zip(first, again, strict=True))
    return "" if same else "equal arguments give other bits the second time"


def _lanes(belief: Gaussian, which: np.ndarray) -> Gaussian:
    return Gaussian(belief.mean[which], belief.cov[which])


def _same_bits(one: Gaussian, other: Gaussian) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def _check(
    name: str,
    curve: float,
    seen: Callable[[Filter, FilterCase], str],
    checked: CheckedFilter,
    cases: Sequence[int],
) -> PromiseResult:
    for number in cases:
        case = draw_filter_case(number, 0.0 if checked.only_linear else curve)
        if found := fault_of(lambda case=case: seen(checked.of(case.states), case)):
            size = f"states {case.states}, entries of a reading {case.readings.shape[-1]}"
            status = "note" if name in checked.unclaimed else "BROKEN"
            return PromiseResult(status, f"case {number}, {size}: {found}", number)
    return PromiseResult("holds", f"{len(cases)} models")


def _promise(
    name: str, says: str, curve: float, seen: Callable[[Filter, FilterCase], str]
) -> Promise[CheckedFilter]:
    return Promise(name, says, partial(_check, name, curve, seen))


FILTER_PROMISES: tuple[Promise[CheckedFilter], ...] = (
    _promise("lanes", "each lane (R, N) has its own result", _CURVE, _each_lane_has_its_own_result),
    _promise("failed-lanes", "a lane of NaN fails alone", _CURVE, _failed_lanes_fail_alone),
    _promise("missing", "an entry of NaN says nothing", _CURVE, _missing_entries_say_nothing),
    _promise("gate", "a lane beyond the gate is kept", _CURVE, _gated_lanes_keep_their_belief),
    _promise(
        "covariance", "results are finite, cov positive definite", _CURVE, _results_are_covariances
    ),
    _promise(_LINEAR, "linear models: the Kalman filter", 0.0, _equals_the_kalman_filter),
    _promise(_UNITS, "units of states, readings do not matter", _CURVE, _units_do_not_matter),
    _promise("memory", "equal arguments give equal bits", _CURVE, _nothing_is_remembered),
    AGREEMENT,
)
