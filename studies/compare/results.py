"""The result of a comparison: one xarray data set over cases, rules and runs, and its figures."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from concord.results.figures.figure_table import FIGURES
from concord.results.figures.intervals import Interval, ratio_t
from concord.results.figures.summary import intervals_of, level_of
from concord.results.folder import provenance
from concord.results.verdict.findings import VerdictLevel
from concord.scenarios.catalogue import definition_named
from concord.studies.compare.entries import ComparedEntry
from concord.studies.compare.run import TAKEN, Figures

if TYPE_CHECKING:
    import xarray

_NODE_US = ("us", "processor time of a step at the node with the most neighbours")


class RuleFigures(msgspec.Struct, frozen=True):
    """One rule on one case; NaN figures and a reason where it cannot run.

    `level` is that of the verdict. `to_centralised` is the root mean square error over that of one
    filter that hears everything, both of the same runs. `node_ratio` is `node_us` over that of the
    cheapest rule of the case.
    """

    rule: str
    level: VerdictLevel
    to_centralised: Interval
    anees: Interval
    bytes_per_step: Interval
    bus_time_us: Interval
    node_us: float
    node_ratio: float
    reason: str


class CaseFigures(msgspec.Struct, frozen=True):
    """One case: its options, its runs, and its rules in order of their errors."""

    case: str
    purpose: str
    options: dict[str, str]
    runs: int
    rules: list[RuleFigures]


class ComparisonFigures(msgspec.Struct, frozen=True):
    """All cases, with 95 % intervals over runs; [value, low, high]."""

    cases: list[CaseFigures]
    versions: dict[str, str]
    commit: str


def assemble(entries: Sequence[ComparedEntry], figures: Mapping[int, Figures]) -> "xarray.Dataset":
    """Return the data set (case, rule, run) of a comparison; NaN where a rule has no figures."""
    import xarray

    cases = {entry.case.name: entry.case for entry in entries}
    rules = list(dict.fromkeys(entry.rule for entry in entries))
    shape = (len(cases), len(rules))
    most = max(case.runs for case in cases.values())
    values: dict[str, np.ndarray] = {name: np.full((*shape, most), np.nan) for name in TAKEN}
    values["node_us"] = np.full(shape, np.nan)
    reasons = np.full(shape, "", dtype=object)
    for place, entry in enumerate(entries):
        at = list(cases).index(entry.case.name), rules.index(entry.rule)
        reasons[at] = entry.reason
        for name, array in figures.get(place, {}).items():
            values[name][(*at, slice(array.size)) if array.ndim else at] = array
    variables: dict[str, Any] = {
        name: (("case", "rule", "run")[: array.ndim], array, _described(name))
        for name, array in values.items()
    }
    variables["reason"] = (("case", "rule"), reasons.astype(str), {"long_name": "cannot run"})
    coordinates: dict[str, Any] = {
        "case": list(cases),
        "rule": rules,
        "run": np.arange(most),
        "purpose": ("case", [case.purpose for case in cases.values()]),
        "options": ("case", [msgspec.json.encode(c.options).decode() for c in cases.values()]),
        "runs": ("case", [case.runs for case in cases.values()]),
        "unit": ("case", [_unit(case.options) for case in cases.values()]),
    }
    title = f"concord compare of {len(rules)} rules on {len(cases)} cases"
    return xarray.Dataset(variables, coordinates, {"title": title, **provenance()})


def _described(name: str) -> dict[str, str]:
    figure = FIGURES.get(name)
    units, meaning = _NODE_US if figure is None else (figure.units, figure.meaning)
    return {"units": "as unit" if units == "score" else units, "long_name": meaning}


def _unit(options: Mapping[str, str]) -> str:
    return definition_named(options["scenario"]).score.unit


def comparison_figures(dataset: "xarray.Dataset") -> ComparisonFigures:
    """Return the figures of a comparison with their intervals."""
    return ComparisonFigures(
        [_case(dataset.isel(case=place)) for place in range(dataset.sizes["case"])],
        msgspec.json.decode(dataset.attrs["versions"]),
        dataset.attrs["commit"],
    )


def _case(part: "xarray.Dataset") -> CaseFigures:
    part = part.isel(run=slice(0, int(part["runs"])))
    rules = [str(rule) for rule in part["rule"].to_numpy()]
    arrays = {str(name): variable.to_numpy() for name, variable in part.items()}
    # The centralised filter is the same under every rule but those of sets, which have none here.
    central = np.square(_first_known(arrays["rmse_centralised"]))
    cheapest = _least(arrays["node_us"])
    found = []
    for place, rule in enumerate(rules):
        one = {name: array[place] for name, array in arrays.items()}
        figures = intervals_of({name: one[name] for name in TAKEN}, TAKEN)
        found.append(
            RuleFigures(
                rule, level_of(figures), ratio_t(np.square(one["rmse"]), central),
                figures["anees"], figures["bytes_per_step"], figures["bus_time_us"],
                float(one["node_us"]), float(one["node_us"] / cheapest), str(one["reason"]),
            )
        )  # fmt: skip
    found.sort(key=lambda one: (np.isnan(one.to_centralised.value), one.to_centralised.value))
    options = msgspec.json.decode(str(part["options"].to_numpy()), type=dict[str, str])
    name, purpose = str(part["case"].to_numpy()), str(part["purpose"].to_numpy())
    return CaseFigures(name, purpose, options, int(part["runs"]), found)


def _first_known(arrays: np.ndarray) -> np.ndarray:
    known = [row for row in arrays if not np.isnan(row).all()]
    return known[0] if known else arrays[0]


def _least(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.min()) if len(known) else np.nan
