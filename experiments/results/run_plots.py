"""Pictures of one run: errors and consistency over time, errors by node, ages of shares."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from concord.experiments.results.folder import ARRAYS, Description, read_description
from concord.experiments.results.network_map import Mapped, network_maps
from concord.experiments.results.palette import COLOURS, GREY
from concord.filters.metrics import rmse
from concord.scenarios.baselines import centralised
from concord.scenarios.catalogue import definition_of
from concord.scenarios.rules import is_set_valued
from concord.scenarios.types.buses import occupancy_of

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


def run_figures(folder: Path) -> "dict[str, Figure]":
    """The pictures of a run folder by name.

    Raises:
        ValueError: it is no run folder, or its arrays are missing or no netCDF.
    """
    import xarray

    description = read_description(folder)
    path = folder / ARRAYS
    if not path.is_file():
        raise ValueError(f"{path}: there is none yet; `concord collect {folder}` makes it")
    try:
        data = xarray.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        raise ValueError(
            f"{path}: cannot be read as netCDF ({error}); `concord collect {folder}` makes it again"
        ) from None
    figures = {"error-over-time": _errors(description, data)}
    if not is_set_valued(description.setup.scenario):
        figures["consistency"] = _consistency(description, data)
    figures["network-map"] = _map(description, data)
    if len(data["node"] if "node" in data.coords else data["mean"][0]) > 1:
        figures["share-ages"] = _ages(description, data)
    return figures


def _errors(description: Description, data: "xarray.Dataset") -> "Figure":
    setup = description.setup
    score = definition_of(setup.scenario).score
    states = list(score.states)
    errors = np.sqrt((data["error"].to_numpy()[..., states] ** 2).sum(-1))
    control = data["control"].to_numpy() if "control" in data else None
    central = centralised(setup, data["readings"].to_numpy(), control).mean
    off = np.sqrt(((central - data["truth"].to_numpy())[:, states] ** 2).sum(-1))
    figure, axes, time = _axes(data)
    low, quarter, three, high = np.nanquantile(errors, (0, 0.25, 0.75, 1), axis=1)
    axes.fill_between(time, low, high, color=COLOURS[0], alpha=0.15, linewidth=0,
                      label="all nodes")  # fmt: skip
    axes.fill_between(time, quarter, three, color=COLOURS[0], alpha=0.3, linewidth=0,
                      label="half of the nodes")  # fmt: skip
    axes.plot(time, rmse(errors[..., None], (1,)), color=COLOURS[0], label="network")
    axes.plot(time, off, color=COLOURS[1], linestyle="--", label="one filter that hears everything")
    axes.set(yscale="log", ylabel=f"error [{score.unit}]")
    _finish(figure, axes, description)
    return figure


def _consistency(description: Description, data: "xarray.Dataset") -> "Figure":
    states = len(definition_of(description.setup.scenario).score.nees_states)
    values = data["nees"].to_numpy() / states
    figure, axes, time = _axes(data)
    low, high = np.nanquantile(values, (0.05, 0.95), axis=1)
    axes.fill_between(time, low, high, color=COLOURS[2], alpha=0.2, linewidth=0,
                      label="9 nodes of 10")  # fmt: skip
    axes.plot(time, np.nanmean(values, axis=1), color=COLOURS[2], label="mean of the nodes")
    axes.axhline(1, color=GREY, linestyle="--", linewidth=1, label="consistent")
    axes.set(yscale="log", ylabel="normalised squared error per state")
    _finish(figure, axes, description)
    return figure


def _map(description: Description, data: "xarray.Dataset") -> "Figure":
    score = definition_of(description.setup.scenario).score
    first = min(score.first_step, data.sizes["step"] - 1)
    error: np.ndarray = rmse(data["error"].to_numpy()[first:][..., list(score.states)], (0,))
    return network_maps([Mapped(description.setup, error, _title(description))], score.unit)


def _ages(description: Description, data: "xarray.Dataset") -> "Figure":
    """Mean age of what each node holds of each neighbour."""
    ages = data["ages"].to_numpy().astype(float)
    ages[ages < 0] = np.nan
    known = ~np.isnan(ages).all(axis=0)
    mean = np.full(ages.shape[1:], np.nan)
    mean[known] = np.nanmean(ages[:, known], axis=0)
    np.fill_diagonal(mean, np.nan)
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.2, 4.6), layout="constrained")
    image = axes.imshow(mean, cmap="cividis_r", interpolation="nearest", vmin=0)
    axes.set(xlabel="neighbour", ylabel="node")
    axes.set_title(f"Mean age of held shares\n{_title(description)}", loc="left")
    axes.grid(visible=False)
    figure.colorbar(image, label="communication cycles; dark is older; empty is no neighbour")
    return figure


def _axes(data: "xarray.Dataset") -> tuple[Any, Any, np.ndarray]:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.6, 3.8), layout="constrained")
    return figure, axes, data["time"].to_numpy()


def _finish(figure: Any, axes: Any, description: Description) -> None:
    axes.set_xlabel("time [s]")
    axes.set_title(_title(description), loc="left")
    figure.legend(loc="outside lower center", ncols=4)


def _title(description: Description) -> str:
    scenario = description.setup.scenario
    return (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.network.graph}, {scenario.rule.name}, "
        f"occupancy {occupancy_of(scenario.bus.schedule):g}, seed {scenario.seed}"
    )
