"""The readings that `concord identify` judges, and the filter that hears them all."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.update import Update
from concord.nodes.messages import from_wire
from concord.nodes.rules.local_filter import (
    finite_lanes,
    predict_to_step,
    update_with_reading,
    where,
)
from concord.plants.recorded.channels import earlier
from concord.scenarios.build import filter_of
from concord.scenarios.catalogue import definition_of
from concord.scenarios.identified import Named, believed, named
from concord.scenarios.innovations import innovation_filters
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup, generator
from concord.scenarios.types.identified_values import DELAY


@dataclass(frozen=True, eq=False)
class HeardReadings:
    """Readings of a run or a log, as the filter that hears everything takes them.

    Attributes:
        setup: of the scenario as it is, with plain unscented filters.
        known: the names of what can be sought.
        values: (steps, nodes, r, d), at their stamps; NaN for none.
        truth: (steps, n), NaN where it is not known.
    """

    setup: Setup
    known: Named
    values: np.ndarray
    truth: np.ndarray

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.values)

    def cut(self, steps: int) -> "HeardReadings":
        """The first steps."""
        return replace(self, values=self.values[:steps], truth=self.truth[:steps])

    def without_ends(self, kinds: set[str], steps: int) -> "HeardReadings":
        """The readings of which some kinds lack so many steps at both ends: however delays move the
        others within that, the same ones count."""
        values = self.values.copy()
        for node, of_node in enumerate(self.known.kinds):
            for entry in (place for place, kind in enumerate(of_node) if kind in kinds):
                values[:steps, node, :, entry] = np.nan
                values[self.steps - steps :, node, :, entry] = np.nan
        return replace(self, values=values)

    def moves(self, values: Mapping[str, Any]) -> np.ndarray:
        """By how many steps the delays among these values move each node's entries, integers (...,
        nodes, d)."""
        step_s, found = self.setup.time_step_s, []
        for of_node in self.known.kinds:
            late = [np.asarray(values.get(f"{DELAY}.{kind}", 0.0)) for kind in of_node]
            found.append(late + [np.zeros(())] * (self.values.shape[-1] - len(late)))
        rows = [np.stack(np.broadcast_arrays(*late), axis=-1) for late in found]
        return np.round(np.stack(np.broadcast_arrays(*rows), axis=-2) / step_s).astype(int)

    def by_step(self, values: Mapping[str, Any], lanes: int) -> Iterator[np.ndarray]:
        """The readings (lanes, nodes, r, d) of each step, moved by the delays among the values."""
        moves = self.moves(values)
        if moves.ndim == 2:
            moved = earlier(self.values, moves.tolist()) if moves.any() else self.values
            yield from (np.broadcast_to(one, (lanes, *one.shape)) for one in moved)
            return
        nodes, entries = np.ogrid[: moves.shape[-2], : moves.shape[-1]]
        for step in range(self.steps):
            rows = step + moves
            inside = (rows >= 0) & (rows < self.steps)
            found = self.values[np.where(inside, rows, 0), nodes, :, entries]
            yield np.where(inside[..., None], found, np.nan).swapaxes(-1, -2)


def readings_of(scenario: Scenario) -> HeardReadings:
    """The readings of a log, or of the simulated run of a scenario.

    Raises:
        ValueError: a scenario whose estimates are no Gaussian beliefs, or that closes a loop by the
            estimate of a node.
    """
    scenario = scenario.with_(filter="ukf", identified="")
    setup, definition = prepare(scenario, tries_rule=False), definition_of(scenario)
    plant = definition.plant(scenario)
    draws = plant.draw(partial(generator, scenario), scenario.steps)
    unfit = innovation_filters(setup, draws.measurement.shape[-2:]) is None
    if unfit or definition.delivery is not None or definition.controller(scenario) is not None:
        raise ValueError(
            f"--scenario {scenario.name}: identify needs Gaussian beliefs, sensors that reach "
            "their nodes and a plant without a controller; name another scenario"
        )
    truth, readings = [from_wire(setup.initial_state)], []
    for step in range(scenario.steps):
        if step:
            truth.append(plant.advance(truth[-1], None, draws.process[step - 1], step - 1))
        readings.append(plant.observe(truth[-1], draws.measurement[step], step))
    return HeardReadings(setup, named(definition, scenario), np.stack(readings), np.stack(truth))


def updates(
    log: HeardReadings, values: Mapping[str, Any], lanes: int
) -> Iterator[tuple[int, list[Update]]]:
    """Each step, and the updates (lanes,) of the filter that hears everything in it.

    Values by name are numbers, or arrays (lanes,). Gates are off. A lane that fails keeps its
    belief.
    """
    scenario = log.setup.scenario
    definition = believed(definition_of(scenario), values)
    model, own_filter = definition.model(scenario), filter_of(log.setup)
    each = [(node, definition.sensor(scenario, node)) for node in range(scenario.nodes)]
    sensors = [(node, sensor) for node, sensor in each if sensor is not None]
    mean, cov = np.array(log.setup.prior_mean), np.array(log.setup.prior_cov)
    belief = Gaussian(np.tile(mean, (lanes, 1)), np.tile(cov, (lanes, 1, 1)))
    for step, readings in enumerate(log.by_step(values, lanes)):
        if step:
            moved, sound = predict_to_step(belief, None, step, model, own_filter)
            belief = where(sound, moved, belief)
        found = []
        for node, sensor in sensors:
            for place in range(readings.shape[2]):
                delivered = readings[:, node, place]
                if np.isnan(delivered).all():
                    continue
                taken = sensor.interpret(delivered)
                found.append(update_with_reading(belief, taken, step, sensor, own_filter))
                belief = where(finite_lanes(found[-1].belief), found[-1].belief, belief)
        yield step, found
