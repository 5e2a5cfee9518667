"""Histories of many runs as the data set of run.nc, and back."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from concord.results.records.extras import run_extras
from concord.results.records.histories import Histories, RunCost
from concord.results.records.netcdf_file import optional_variables, read_dataset, state_coordinates
from concord.results.records.trace import Past
from concord.scenarios.catalogue import definition_of
from concord.scenarios.innovations import Innovations
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    import xarray

_ALWAYS = (
    "truth", "mean", "cov_trace", "nees", "payload_bytes", "asked", "classes", "readings",
    "prior_mean",
)  # fmt: skip
_OPTIONAL = ("control", "ages", "cov")
_COUNTER = "counter"


def histories_dataset(histories: Histories, cost: RunCost | None = None) -> "xarray.Dataset":
    """Return the histories with named dimensions and units, and what the runs cost."""
    # Loading xarray can take longer than a run, so it is loaded only to write a file.
    import xarray

    setup = histories.setup
    definition = definition_of(setup.scenario)
    names = definition.plant(setup.scenario).state_names
    state = ("run", "step", "node", "state")
    per_share = ("run", "step", "round", "node")
    variables: dict[str, Any] = {
        "truth": (("run", "step", "state"), histories.truth),
        "mean": (state, histories.mean),
        "cov_trace": (state[:-1], histories.cov_trace),
        "nees": (
            state[:-1],
            histories.nees,
            {"states": [names[i] for i in definition.score.nees_states]},
        ),
        "payload_bytes": (per_share, histories.payload_bytes, {"units": "B"}),
        "asked": (per_share, histories.asked.astype(np.int8)),
        "classes": (per_share, histories.classes),
        "prior_mean": (("run", "state"), histories.prior_mean),
        **{
            name.replace(" ", "_").replace("-", "_"): (("run", "node"), counts, {_COUNTER: name})
            for name, counts in histories.counters.items()
        },
    }
    if histories.readings is not None:
        dimensions = ("run", "step", "node", "reading", "channel")
        variables["readings"] = (dimensions, histories.readings)
    if histories.ages is not None:
        units = {"units": "communication cycles"}
        variables["ages"] = (("run", "step", "link"), histories.ages, units)
    if histories.cov is not None:
        variables["cov"] = ((*state, "other_state"), histories.cov)
    if histories.innovations is not None:
        # Only here: most runs keep no innovations.
        from concord.results.innovations.of_run import variables_of

        variables |= variables_of(histories.innovations, "", ("run", "step"))
    optional = histories.control, histories.suspect, histories.past
    variables |= optional_variables(("run", "step"), *optional)
    extras = run_extras(setup.scenario)
    if extras is not None and histories.extras:
        of_runs = histories.runs.tolist(), histories.extras
        variables |= extras.variables_of_runs(setup, *of_runs)
    receiver, sender = setup.links
    coordinates = {
        "run": histories.runs,
        **state_coordinates(setup, setup.scenario.steps),
        "receiver": ("link", receiver),
        "sender": ("link", sender),
    }
    spent = {} if cost is None else cost._asdict()
    return xarray.Dataset(variables, coordinates, spent)


def read_histories(path: Path, setup: Setup) -> tuple[Histories, RunCost]:
    """Return the histories of a run.nc of many runs, and what they cost.

    Records of labelled rules are not in the file: `spreads` is empty.

    Raises:
        ValueError: the file cannot be read, or is none of many runs of this setup.
    """
    remedy = "run the scenario again with --driver batched"
    data = read_dataset(path, ("run", *_ALWAYS), remedy)
    scenario = setup.scenario
    expected = (data.sizes["run"], scenario.steps, scenario.nodes, len(setup.prior_mean))
    spent = {name: data.attrs[name] for name in RunCost._fields if name in data.attrs}
    if data["mean"].shape != expected or len(spent) < len(RunCost._fields):
        raise ValueError(f"{path}: does not hold the runs that run.json describes; {remedy}")
    arrays: dict[str, Any] = {name: data[name].to_numpy() for name in _ALWAYS}
    arrays |= {name: data[name].to_numpy() if name in data else None for name in _OPTIONAL}
    runs, extras = data["run"].to_numpy(), run_extras(scenario)
    there = np.isfinite(arrays["mean"]).all(axis=-1)
    histories = Histories(
        setup=setup,
        runs=runs,
        counters={
            str(one.attrs[_COUNTER]): one.to_numpy()
            for one in data.data_vars.values()
            if _COUNTER in one.attrs
        },
        innovations=_read_innovations(data),
        past=_read_past(data),
        suspect=data["suspect"].to_numpy() > 0 if "suspect" in data else None,
        spreads=(),
        extras=() if extras is None else tuple(extras.read_runs(data, setup, there)),
        **arrays,
    )
    return histories, RunCost(**{name: float(one) for name, one in spent.items()})


def _read_innovations(data: "xarray.Dataset") -> Innovations | None:
    if "nis" not in data:
        return None
    return Innovations(*(data[name].to_numpy() for name in ("innovation", "innovation_cov", "nis")))


def _read_past(data: "xarray.Dataset") -> Past | None:
    if "smoothed_mean" not in data:
        return None
    return Past(data["smoothed_mean"].to_numpy(), data["smoothed_std"].to_numpy())
