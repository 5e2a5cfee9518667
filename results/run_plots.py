"""Pictures of a run folder: errors and consistency over time, errors by node, ages of shares."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from concord.filters.metrics import mean_of_known, rmse
from concord.results.figures.network_errors import scored_steps
from concord.results.figures.smoothed_errors import smoothed_errors
from concord.results.folder import Description, read_shown
from concord.results.innovations.plots import innovation_figure
from concord.results.network_map import Mapped, network_maps
from concord.results.palette import COLOURS, GREY
from concord.results.records.extras import Past
from concord.results.records.netcdf_file import ARRAYS, read_dataset
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.catalogue import beside_truth, definition_of
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.plants import PlacedSensors
from concord.scenarios.types.schedules import occupancy_of
from concord.scenarios.user.trust import require_known

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


def run_figures(folder: Path) -> "dict[str, Figure]":
    """The pictures of a run folder, of one run or of many, by name.

    Raises:
        ValueError: it is no run folder, or its arrays are missing or damaged.
    """
    description = read_shown(folder)
    data = _arrays(folder, description)
    description = _as_it_ran(folder, description, data)
    figures, told = {}, _told(description, data)
    if told.any():
        figures["error-over-time"] = _errors(description, data, told)
    if told.any() and not is_set_valued(description.setup.scenario):
        figures["consistency"] = _consistency(description, data, told)
    if "nis" in data:
        score = definition_of(description.setup.scenario).score
        first = min(score.first_step, data.sizes["step"] - 1)
        figures["innovations"] = innovation_figure(data, first, _title(description, data))
    if "smoothed_mean" in data and told.any():
        figures["error-against-lag"] = _lags(description, data)
    if told.any():
        figures["network-map"] = _map(description, data)
    if description.setup.scenario.nodes > 1:
        figures["share-ages"] = _ages(description, data)
    return figures


def _arrays(folder: Path, description: Description) -> "xarray.Dataset":
    """The arrays of R runs: mean (R, S, N, n), and so on."""
    path = folder / ARRAYS
    if not path.is_file():
        raise ValueError(f"{path}: there is none yet; `concord collect {folder}` makes it")
    again = f"`concord collect {folder}` makes it again where the folder has a run.mcap"
    data = read_dataset(path, ("run", "time", "truth", "mean", "nees", "readings", "ages"), again)
    states = len(description.setup.prior_mean)
    if data["mean"].shape[2:] != (description.setup.scenario.nodes, states):
        raise ValueError(f"{path}: is of other nodes or states than run.json; {again}")
    return data


def _as_it_ran(folder: Path, description: Description, data: "xarray.Dataset") -> Description:
    """The description whose sensors stand in each step where they stood in the run.

    Raises:
        ValueError: run.nc does not say what was run.
    """
    setup = description.setup
    if not isinstance(setup.scenario.plant, PlacedSensors):
        return description
    try:
        ran = msgspec.json.decode(data.attrs.get("scenario", ""), type=Scenario)
    except msgspec.DecodeError:
        raise ValueError(f"{ARRAYS}: does not say which scenario was run; make it again") from None
    require_known(ran, folder / ARRAYS)
    scenario = msgspec.structs.replace(setup.scenario, plant=ran.plant)
    setup = msgspec.structs.replace(setup, scenario=scenario)
    return msgspec.structs.replace(description, setup=setup)


def _told(description: Description, data: "xarray.Dataset") -> np.ndarray:
    """At which steps (S,) the truth of the scored states is known; of a log, seldom at all."""
    states = list(definition_of(description.setup.scenario).score.states)
    known = np.isfinite(data["truth"].to_numpy()[..., states])
    return np.asarray(known.all(axis=-1).any(axis=0))


def _errors(description: Description, data: "xarray.Dataset", told: np.ndarray) -> "Figure":
    setup = description.setup
    score = definition_of(setup.scenario).score
    errors = np.sqrt((_error(data)[..., list(score.states)] ** 2).sum(-1))
    control = data["control"].to_numpy() if "control" in data else None
    runs = data["run"].to_numpy().tolist()
    central = centralised_of_runs(setup, runs, data["readings"].to_numpy(), control).mean
    truth = data["truth"].to_numpy()
    off = beside_truth(setup.scenario, central, truth) - truth
    figure, axes, time = _axes(data)
    time, errors, off = time[told], errors[:, told], off[:, told]
    low, quarter, three, high = np.nanquantile(errors, (0, 0.25, 0.75, 1), axis=(0, 2))
    of_runs = " in all runs" if len(runs) > 1 else ""
    axes.fill_between(time, low, high, color=COLOURS[0], alpha=0.15, linewidth=0,
                      label=f"all nodes{of_runs}")  # fmt: skip
    axes.fill_between(time, quarter, three, color=COLOURS[0], alpha=0.3, linewidth=0,
                      label="half of the nodes")  # fmt: skip
    axes.plot(time, rmse(errors[..., None], (0, 2)), color=COLOURS[0], label="network")
    if not np.isnan(off).all():
        axes.plot(time, rmse(off[..., list(score.states)], (0,)), color=COLOURS[1], linestyle="--",
                  label="one filter that hears everything")  # fmt: skip
    axes.set(yscale="log", ylabel=f"error [{score.unit}]")
    _finish(figure, axes, description, data)
    return figure


def _error(data: "xarray.Dataset") -> np.ndarray:
    """Errors (R, S, N, n) of the nodes."""
    return data["mean"].to_numpy() - data["truth"].to_numpy()[:, :, None]


def _consistency(description: Description, data: "xarray.Dataset", told: np.ndarray) -> "Figure":
    states = len(definition_of(description.setup.scenario).score.nees_states)
    values = data["nees"].to_numpy() / states
    figure, axes, time = _axes(data)
    time, values = time[told], values[:, told]
    low, high = np.nanquantile(values, (0.05, 0.95), axis=(0, 2))
    axes.fill_between(time, low, high, color=COLOURS[2], alpha=0.2, linewidth=0,
                      label="9 nodes of 10")  # fmt: skip
    axes.plot(time, np.nanmean(values, axis=(0, 2)), color=COLOURS[2], label="mean of the nodes")
    axes.axhline(1, color=GREY, linestyle="--", linewidth=1, label="consistent")
    axes.set(yscale="log", ylabel="normalised squared error per state")
    _finish(figure, axes, description, data)
    return figure


def _lags(description: Description, data: "xarray.Dataset") -> "Figure":
    """Error of the states of some steps ago, known better from step to step."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    setup = description.setup
    score = definition_of(setup.scenario).score
    readings, truth = data["readings"].to_numpy(), data["truth"].to_numpy()
    control = data["control"].to_numpy() if "control" in data else None
    central = centralised_of_runs(setup, data["run"].to_numpy().tolist(), readings, control)
    past = Past(data["smoothed_mean"].to_numpy(), data["smoothed_std"].to_numpy())
    counted = scored_steps(score, readings)
    errors = smoothed_errors(setup, past, central, truth, control, counted)
    network, best = (rmse(one[..., None], (0,)) for one in errors)
    figure, axes = plt.subplots(figsize=(6.6, 3.8), layout="constrained")
    lags = data["lag"].to_numpy()
    axes.plot(lags, network, color=COLOURS[0], marker="o", markersize=3, label="network")
    axes.plot(lags, best, color=COLOURS[1], linestyle="--",
              label="one smoother that hears everything")  # fmt: skip
    axes.axhline(best[0], color=GREY, linestyle=":", label="one filter that hears everything")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(ylim=(0, None), xlabel="lag [steps]", ylabel=f"error [{score.unit}]")
    axes.set_title(_title(description, data), loc="left")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def _map(description: Description, data: "xarray.Dataset") -> "Figure":
    score = definition_of(description.setup.scenario).score
    first = min(score.first_step, data.sizes["step"] - 1)
    error: np.ndarray = rmse(_error(data)[:, first:][..., list(score.states)], (0, 1))
    title = _title(description, data)
    return network_maps([Mapped(description.setup, error, title)], score.unit)


def _ages(description: Description, data: "xarray.Dataset") -> "Figure":
    """Mean age of what each node holds of each neighbour."""
    found = data["ages"].to_numpy().astype(float)
    found[found < 0] = np.nan
    nodes = description.setup.scenario.nodes
    mean = np.full((nodes, nodes), np.nan)
    of_links = mean_of_known(found, (0, 1))
    mean[data["receiver"].to_numpy(), data["sender"].to_numpy()] = of_links
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.2, 4.6), layout="constrained")
    image = axes.imshow(mean, cmap="cividis_r", interpolation="nearest", vmin=0)
    axes.set(xlabel="neighbour", ylabel="node")
    axes.set_title(f"Mean age of held shares\n{_title(description, data)}", loc="left")
    axes.grid(visible=False)
    figure.colorbar(image, label="communication cycles; dark is older; empty is no neighbour")
    return figure


def _axes(data: "xarray.Dataset") -> tuple[Any, Any, np.ndarray]:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.6, 3.8), layout="constrained")
    return figure, axes, data["time"].to_numpy()


def _finish(figure: Any, axes: Any, description: Description, data: "xarray.Dataset") -> None:
    axes.set_xlabel("time [s]")
    axes.set_title(_title(description, data), loc="left")
    figure.legend(loc="outside lower center", ncols=4 if data.sizes["run"] == 1 else 2)


def _title(description: Description, data: "xarray.Dataset") -> str:
    scenario = description.setup.scenario
    runs = f", {data.sizes['run']} runs" if data.sizes["run"] > 1 else ""
    return (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.network.graph}, {scenario.rule.name}, "
        f"occupancy {occupancy_of(scenario.bus.schedule):g}, seed {scenario.seed}{runs}"
    )
