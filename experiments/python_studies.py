"""Functions of `import concord as cc` for many runs; docs/python_api.md explains them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from concord.entries import summaries
from concord.filters.filter import Filter
from concord.scenarios.catalogue import definition_of
from concord.scenarios.definitions.own import portable
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario, in_words
from concord.scenarios.types.assignment import flat
from concord.scenarios.types.option import Choice, python_words, require_kind
from concord.scenarios.user.values import kept_source
from concord.studies.compare.entries import asked_cases, check_together, entries_of, own_rules
from concord.studies.compare.output import write_comparison
from concord.studies.compare.results import assemble, comparison_figures
from concord.studies.compare.run import compute_missing, kept_before
from concord.studies.design.candidates import Cost
from concord.studies.design.results import Design, design_of
from concord.studies.design.search import SearchTask, search
from concord.studies.design.space import placements_of, space_of
from concord.studies.design.target import BusLimits, parse_target
from concord.studies.sweep.cells import with_keep
from concord.studies.sweep.engines import engine_for, workers_here
from concord.studies.sweep.run import begin, finish
from concord.studies.sweep.specification import Specification, shown, specify

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from concord.studies.exact.results import Exact
    from concord.studies.identify.identify import Identification

from concord.experiments.python_api import at_least_one


@python_words()
def sweep(
    scenario: Scenario | str | Sequence[str] = "target-tracking",
    *,
    runs: int = 20,
    samples: int | None = None,
    keep: Literal["moments", "figures", "histories"] | None = None,
    workers: int = 1,
    out: Path | str | None = None,
    exact: bool = False,
    **options: Any,
) -> "xarray.Dataset":
    """Every combination of the options' values; docs/sweeps.md names the variables.

    Args:
        scenario: a scenario, or names of some.
        runs: of each cell, with the same noise in every cell.
        samples: so many cells of a Latin hypercube instead.
        keep: histories or figures of every run, or moments over the runs; when left out histories,
            and moments of more than 1e8 estimates.
        workers: processes; with more than one, a script needs `if __name__ == "__main__":`.
        out: netCDF file to keep the result and, on the way, each finished piece in.
        exact: expectations over all noise; a run is then a pattern of losses (docs/exact.md).
        options: one value, or several in a list; ranges as text, "0.1..1".

    Raises:
        ValueError: a cell that cannot run, or an `out` that belongs to another sweep.
    """
    # Another process, or a later call that resumes, finds own values by their files alone.
    is_alone = workers == 1 and out is None
    asked = _specification(scenario, options, runs, samples, is_alone, exact)
    specification = with_keep(asked, keep)
    begun = begin(specification, None if out is None else Path(out), workers_here(workers))
    dataset = finish(begun, engine_for(workers, None), lambda _: None).dataset
    assert dataset is not None, "only a shard has none"
    return dataset


@python_words()
def compare(
    rules: Sequence[Any] = (),
    *,
    cases: Sequence[str] | None = None,
    runs: int | None = None,
    data: Path | str | None = None,
    workers: int = 1,
    out: Path | str | None = None,
    exact: bool = False,
) -> "xarray.Dataset":
    """Every built-in rule and your own on a fixed suite of cases; docs/which_rule_when.md.

    Args:
        rules: your own, as functions or as FILE.py:NAME.
        cases: names of cases; all when left out.
        runs: of every case; those of the suite when left out.
        data: folder of the data of recorded cases.
        workers: processes; with more than one, a rule must be at the top of a file.
        out: folder that keeps each finished entry, and gets report.html, results.nc, table.tex,
            table.md and compare.json.
        exact: take errors from exact second moments where a case and a rule have them.

    Returns:
        rmse, rmse_centralised, anees, bytes_per_step, wire_us (case, rule, run), node_us and
        reason (case, rule).

    Raises:
        ValueError: a rule, a case or data that cannot be used.
    """
    require_kind("rules", rules, Sequence, "a list of functions or of FILE.py:NAME")
    sources = own_rules([_word("rule", rule) for rule in rules])
    names = [getattr(rule, "__name__", source) for rule, source in zip(rules, sources, strict=True)]
    own = {
        source if name in summaries("RULES") or names.count(name) > 1 else name: source
        for name, source in zip(names, sources, strict=True)
    }
    entries = entries_of(asked_cases(cases, runs), own, None if data is None else str(data), exact)
    check_together(entries, workers_here(workers))
    engine, folder = engine_for(workers, None), None if out is None else Path(out)
    done = kept_before(entries, folder)
    dataset = assemble(*compute_missing(entries, done, folder, engine, lambda _: None))
    if folder is not None:
        write_comparison(dataset, comparison_figures(dataset), folder)
    return dataset


@python_words()
def exact(
    scenario: Scenario,
    *,
    patterns: int = 20,
) -> "Exact":
    """The errors of a network on a linear plant, exact to rounding, without runs; docs/exact.md.

    Args:
        scenario: what to compute.
        patterns: of losses, those of so many runs; without losses one is enough.

    Returns:
        second moments of the errors of each node in each step, with rmse, honesty, steady state.

    Raises:
        ValueError: a scenario without exact covariances; the message says why.
    """
    # Only here: studies of runs need nothing of it.
    from concord.studies.exact.results import exact_of

    require_kind("scenario", scenario, Scenario, "a scenario, such as cc.scenario('oscillator')")
    at_least_one("patterns", patterns)
    first = scenario.run
    return exact_of(prepare(scenario), range(first, first + patterns))


@python_words()
def identify(
    scenario: Scenario, seek: str | Sequence[str] = (), *, out: Path | str | None = None
) -> "Identification":
    """The noise, delays and parameters that explain the readings of a scenario best;
    docs/own_data.md.

    Args:
        scenario: with the readings of a log, or with simulated ones.
        seek: names such as "R.gps,Q.speed,delay.imu,theta.mass"; all R and Q when left out.
        out: file that `own_scenario(..., identified=FILE)` takes.

    Returns:
        each value with its interval, and the verdict before and after. `scenario.with_(identified=
        result.word)` believes in them.

    Raises:
        ValueError: a name that the scenario does not have; the message lists the right ones.
    """
    # Only here: other studies fit nothing.
    from concord.studies.identify.identify import identify as identified

    require_kind("scenario", scenario, Scenario, "a scenario, such as cc.own_scenario(...)")
    names = seek.split(",") if isinstance(seek, str) else seek
    result = identified(scenario, [one.strip() for one in names if one.strip()])
    if out is not None:
        result.write(Path(out))
    return result


@python_words()
def design(
    target_rmse: str,
    scenario: Scenario | str | Sequence[str] = "target-tracking",
    *,
    minimise: Cost = "bytes",
    latency_ms: float | None = None,
    load: float | None = None,
    runs: int = 100,
    workers: int = 1,
    exact: bool = False,
    **options: Any,
) -> Design:
    """The cheapest network that meets an error target; its `recommended` is None if none does.

    Args:
        target_rmse: "1.5x-centralised", "2x-bound", or a number in the scenario's unit.
        scenario: a scenario, or names of some.
        minimise: bytes or microseconds of the bus per step, nodes per cycle, or energy per step.
        latency_ms: longest delay from a measurement to the end of the last share of its step.
        load: greatest fraction of a cycle in which the bus carries frames.
        runs: fresh runs that confirm the recommended network.
        workers: processes; with more than one, a script needs `if __name__ == "__main__":`.
        exact: take errors from exact second moments where a candidate has them.
        options: one value is settled, of several in a list the search takes the best.

    Raises:
        ValueError: a target that is none, or no candidate that can run.
    """
    must = "a text, such as '1.5x-centralised' or '8'"
    require_kind("target_rmse", target_rmse, str, must)
    target, limits = parse_target(target_rmse), BusLimits(latency_ms, load)
    limits.check()
    specification = _specification(scenario, options, runs, None, workers == 1)
    settled, space = space_of(specification)
    engine = engine_for(workers, None)
    placements = placements_of(specification)
    task = SearchTask(
        target, minimise, settled, space, runs, engine, workers_here(workers), lambda _: None,
        placements=placements, limits=limits, exact=exact,
    )  # fmt: skip
    return design_of(task, search(task, [], []), True)


def plots(result: "xarray.Dataset | Design") -> "dict[str, Figure]":
    """Return the pictures of a sweep or a design by name.

    Raises:
        ValueError: a result of neither.
    """
    # Only here: other functions need no data sets.
    import xarray

    must = "what cc.sweep or cc.design returns; `concord plot FOLDER` draws a run"
    require_kind("plots", result, (xarray.Dataset, Design), must)
    if isinstance(result, Design):
        from concord.studies.design.plots import design_figures

        return design_figures(result)
    if "specification" not in result.attrs:
        raise ValueError(f"plots of a data set of {sorted(map(str, result.sizes))}: must be {must}")
    from concord.studies.sweep.plots import sweep_figures

    return sweep_figures(result)


def _specification(
    scenario: Scenario | str | Sequence[str],
    options: Mapping[str, Any],
    runs: int,
    samples: int | None,
    is_alone: bool,
    exact: bool = False,
) -> Specification:
    at_least_one("runs", runs)
    if isinstance(scenario, Scenario):
        carried = scenario if is_alone else portable(scenario)
        usual = flat(definition_of(carried).defaults)
        base = {k: v for k, v in flat(carried).items() if k != "scenario" and usual.get(k) != v}
        options = {"scenario": carried.name, **base, **options}
    else:
        options = {"scenario": scenario, **options}
    asked = {name: _values(name, values) for name, values in options.items()}
    return specify(asked, runs=runs, samples=samples, exact=exact)


def _values(name: str, values: Any) -> str:
    """The values of an option in the words of a sweep."""
    if name != "graph" and hasattr(values, "to_numpy"):
        values = values.to_numpy()  # a DataArray, or a Series of pandas
    values = values.tolist() if isinstance(values, np.ndarray) and name != "graph" else values
    several = isinstance(values, Sequence) and not isinstance(values, str)
    if name == "changes" and several and not any(";" in one for one in values):
        return ";".join(values) or "none"
    each = list(values) if several else [values]
    return ",".join(shown(_word(name, value)) for value in each)


def _word(name: str, value: Any) -> Any:
    if isinstance(value, Choice):
        if value != type(value)():
            raise ValueError(
                f"{name}={value}: a sweep takes a choice by its name; give its own options beside "
                f"it, such as {name}={value.name!r}, {type(value).__struct_fields__[0]}=[...]"
            )
        return value.name
    own = isinstance(value, Filter) if name == "filter" else callable(value)
    if own and name in ("rule", "bus", "filter"):
        return kept_source(value).name
    return value if name == "changes" else in_words({name: value})[name]
