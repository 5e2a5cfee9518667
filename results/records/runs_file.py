"""The record of runs as the data set of run.nc, and back."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from concord.results.bus.bus_times import times_of
from concord.results.records.extras import Past, run_extras
from concord.results.records.netcdf_file import Arrays, read_dataset, state_coordinates
from concord.results.records.runs import RunCost, Runs
from concord.scenarios.catalogue import definition_of
from concord.scenarios.innovations import HearsAll, Innovations
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    import xarray

_STEP, _NODE = ("run", "step"), ("run", "step", "node")
_STATE, _SHARE, _READING = (*_NODE, "state"), ("run", "step", "round", "node"), (*_NODE, "reading")
_COUNTER = "counter"
_SET = "cov is the shape matrix P of a set e' P^-1 e <= 1 that holds the truth"
_CYCLES = {"units": "communication cycles"}
_FIELDS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "truth": ((*_STEP, "state"), {}),
    "control": ((*_STEP, "input"), {}),
    "mean": (_STATE, {}),
    "cov": ((*_STATE, "other_state"), {}),
    "cov_trace": (_NODE, {}),
    "nees": (_NODE, {}),
    "payload_bytes": (_SHARE, {"units": "B"}),
    "asked": (_SHARE, {}),
    "classes": (_SHARE, {}),
    "cut": (_SHARE, {"meaning": "only the first frames of the share were sent"}),
    "prior_mean": (("run", "state"), {}),
    "readings": ((*_READING, "channel"), {}),
    "ages": ((*_STEP, "link"), _CYCLES),
    "suspect": (_NODE, {}),
    "estimate_age_s": (_NODE, {"units": "s", "origin": "sampling instant of the step"}),
    "duality_gap": (
        _NODE, {"meaning": "the trace of the set is within this fraction of the least"},
    ),
}  # fmt: skip
"""Fields of `Runs` that are variables of the same name: dimensions and attributes."""
_FLAGS = ("asked", "cut", "suspect")
_PAST = {"smoothed_mean": (*_STEP, "lag", "node", "state")}
_PAST["smoothed_std"] = _PAST["smoothed_mean"]
_INNOVATIONS = {
    "innovation": (*_READING, "entry"),
    "innovation_cov": (*_READING, "entry", "other_entry"),
    "nis": _READING,
}


def runs_dataset(runs: Runs) -> "xarray.Dataset":
    """Return the record as a data set of xarray."""
    # Only here: a run that writes a file needs no xarray.
    import xarray

    return xarray.Dataset(*runs_arrays(runs))


def runs_arrays(runs: Runs, cost: RunCost | None = None, heard: HearsAll | None = None) -> Arrays:
    """Return the record with named dimensions and units.

    Args:
        runs: the record.
        cost: what the runs cost, as attributes.
        heard: the filter that hears everything; its innovations are more variables.
    """
    setup = runs.setup
    definition = definition_of(setup.scenario)
    variables: dict[str, Any] = {
        name: (axes, np.asarray(one, np.int8) if name in _FLAGS else one, dict(said))
        for name, (axes, said) in _FIELDS.items()
        if (one := getattr(runs, name)) is not None
    }
    names = definition.plant(setup.scenario).state_names
    score = definition.score
    variables["nees"][2]["states"] = [names[i] for i in score.nees_states]
    variables["mean"][2].update(scored=[names[i] for i in score.states], scored_unit=score.unit)
    if is_set_valued(setup.scenario):
        variables["nees"][2]["meaning"] = _SET
    variables |= {
        name.replace(" ", "_").replace("-", "_"): (("run", "node"), counts, {_COUNTER: name})
        for name, counts in runs.counters.items()
    }
    if heard is not None:
        # Only here: runs as arrays have none.
        from concord.results.innovations.figures import outside_model

        outside = outside_model(setup, heard.belief, np.ones(runs.truth.shape[:2], dtype=bool))
        if outside.shares is not None:
            variables["outside_model"] = (_STEP, outside.steps.astype(np.int8))
    best = None if heard is None else heard.innovations
    for prefix, found in (("", runs.innovations), ("centralised_", best)):
        if found is not None:
            pairs = zip(_INNOVATIONS.items(), found, strict=True)
            variables |= {f"{prefix}{name}": (axes, one) for (name, axes), one in pairs}
    if runs.past is not None:
        variables |= dict(zip(_PAST, zip(_PAST.values(), runs.past, strict=True), strict=True))
        variables["lag"] = (("lag",), np.arange(runs.past.mean.shape[2]), {"units": "steps"})
    if (extras := run_extras(setup.scenario)) is not None and runs.extras:
        variables |= extras.variables(setup, runs.runs.tolist(), runs.extras, runs.readings)
    variables |= _of_one_run(runs)
    coordinates = {
        "run": runs.runs,
        **state_coordinates(setup, runs.steps),
        "receiver": ("link", runs.links[0]),
        "sender": ("link", runs.links[1]),
    }
    attributes = {"scenario": msgspec.json.encode(setup.scenario).decode()}
    return Arrays(variables, coordinates, attributes | (cost._asdict() if cost else {}))


def _of_one_run(runs: Runs) -> dict[str, Any]:
    """Return what the rounds of one run alone make worth its place: ages of records, and times."""
    found: dict[str, Any] = {}
    if len(runs.runs) > 1:
        return found
    if runs.spreads:
        # Only here: other rules have no records.
        from concord.results.records.record_spread import record_ages

        ages = record_ages(runs.spreads[0]).swapaxes(0, 1)[None]
        found["record_age"] = ((*_NODE, "source"), ages, {"units": "steps"})
    if (times := times_of(runs)) is not None:
        in_cycle = {"units": "us", "origin": "beginning of the communication cycle"}
        of_run = {"units": "1", "origin": "beginning of the run"}
        found |= {
            "bus_cycle": (_SHARE[:3], times.bus_cycle[None], of_run),
            "bus_load": (_SHARE[:3], times.load[None], {"units": "1"}),
            "delay_us": (_STEP, times.delay_us[None], {"units": "us"}),
            "share_start_us": (_SHARE, times.share_start_us[None], in_cycle),
            "share_end_us": (_SHARE, times.share_end_us[None], in_cycle),
        }
    return found


def runs_of_dataset(data: "xarray.Dataset", setup: Setup | None = None) -> Runs:
    """Return the record of a data set, of its own scenario where no setup is given.

    Records of labelled rules and the history of members are not in a data set.

    Raises:
        ValueError: it holds no runs, or those of another scenario.
    """
    try:
        found = setup or prepare(_own_scenario(data))
        arrays = {n: data[n].to_numpy() if n in data else None for n in _FIELDS}
        mean, truth = data["mean"].to_numpy(), data["truth"]
    except (KeyError, msgspec.DecodeError) as error:
        raise ValueError(f"the data set holds no runs of a scenario ({error})") from None
    expected = (found.scenario.nodes, len(found.prior_mean))
    if mean.ndim != 4 or mean.shape[2:] != expected or truth.ndim != 3:
        raise ValueError("the data set holds runs of other nodes or states than its scenario")
    for name in ("asked", "cut", "suspect"):
        flags = arrays[name]
        arrays[name] = None if flags is None else flags > 0
    extras, there = run_extras(found.scenario), np.asarray(np.isfinite(mean).all(axis=-1))
    read = [data[name].to_numpy() for name in _INNOVATIONS if name in data]
    past = [data[name].to_numpy() for name in _PAST if name in data]
    return Runs(
        setup=found,
        runs=data["run"].to_numpy(),
        links=(data["receiver"].to_numpy(), data["sender"].to_numpy()),
        counters={
            str(one.attrs[_COUNTER]): one.to_numpy()
            for one in data.data_vars.values()
            if _COUNTER in one.attrs
        },
        innovations=Innovations(*read) if read else None,
        past=Past(*past) if past else None,
        extras=() if extras is None else tuple(extras.read_runs(data, found, there)),
        **arrays,  # pyright: ignore[reportArgumentType]
    )


def _own_scenario(data: "xarray.Dataset") -> Scenario:
    # Only here: most records come from runs, and from no file.
    from concord.scenarios.user.trust import require_known

    scenario = msgspec.json.decode(data.attrs["scenario"], type=Scenario)
    require_known(scenario, Path(data.encoding.get("source", "run.nc")))
    return scenario


def read_runs(path: Path, setup: Setup) -> tuple[Runs, RunCost | None]:
    """Return the record in a run.nc, and what its runs cost, where it says so.

    Raises:
        ValueError: the file cannot be read, or holds no runs of this setup.
    """
    remedy = "run the scenario again"
    data = read_dataset(path, ("run", "truth", "mean", "readings", "ages"), remedy)
    try:
        found = runs_of_dataset(data, setup)
    except ValueError as error:
        raise ValueError(f"{path}: {error}; {remedy}") from None
    spent = [float(data.attrs[name]) for name in RunCost._fields if name in data.attrs]
    return found, RunCost(*spent) if len(spent) == len(RunCost._fields) else None
