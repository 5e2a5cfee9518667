"""Scenarios whose filters believe in other noise, delays and parameters, each by its name."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from concord.filters.turns import angles_of
from concord.nodes.rules.local_filter import Model, Sensor
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import Declared, ScenarioDefinition
from concord.scenarios.types.identified_values import DELAY, THETA, Q, R
from concord.topology.names import unknown_name


def plain_name(name: str) -> str:
    """A name of letters, digits and lines: lateral_acceleration for "lateral acceleration"."""
    return re.sub(r"\W+", "_", name).strip("_")


class Named(NamedTuple):
    """The names of a scenario: the kind of each entry of each node's sensor, and the group of each
    state, "" for one without process noise; whether delays and parameters can change."""

    kinds: tuple[tuple[str, ...], ...]
    groups: tuple[str, ...]
    has_stamps: bool
    declared: Declared | None

    @property
    def names(self) -> tuple[str, ...]:
        """All names, each once, in the order of `TABLES`."""
        kinds = [kind for kinds in self.kinds for kind in kinds]
        every = [f"{R}.{kind}" for kind in kinds]
        every += [f"{Q}.{group}" for group in self.groups if group]
        every += [f"{DELAY}.{kind}" for kind in kinds if self.has_stamps]
        every += [f"{THETA}.{name}" for name in (self.declared.parameters if self.declared else ())]
        return tuple(dict.fromkeys(every))

    def found(self, asked: str) -> str:
        """The name that is asked for; a group of states may be named by one of them.

        Raises:
            ValueError: there is none; the message lists the right ones.
        """
        table, _, rest = asked.partition(".")
        groups = [group for group in self.groups if table == Q and rest in group.split("+")]
        name = f"{Q}.{groups[0]}" if groups and rest else asked
        if name in self.names:
            return name
        error = unknown_name("parameter", asked, self.names)
        if table == DELAY and not self.has_stamps:
            error = ValueError(f"{error}; delays are of a log, and these readings are simulated")
        raise error


def named(definition: ScenarioDefinition, scenario: Scenario) -> Named:
    """The names of a scenario."""
    plant, kinds = definition.plant(scenario), []
    for node in range(scenario.nodes):
        sensor: Any = definition.sensor(scenario, node)
        names = [name for name, _ in getattr(sensor, "channels", ())]
        kinds.append(tuple(map(plain_name, getattr(sensor, "kinds", ()) or names)))
    cov = np.asarray(definition.model(scenario).process_noise_cov(0))
    return Named(
        tuple(kinds),
        _groups(cov, [plain_name(name) for name in plant.state_names]),
        hasattr(plant, "delayed"),
        definition.declared(scenario),
    )


def _groups(cov: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """The group of each state: those whose noise is correlated, directly or by others."""
    joined = np.linalg.matrix_power(np.eye(len(cov)) + (cov != 0), len(cov)) > 0
    return tuple(
        "+".join(name for name, there in zip(names, row, strict=True) if there) if some else ""
        for row, some in zip(joined, np.diagonal(cov) > 0, strict=True)
    )


def _factors(table: str, names: Sequence[str], values: Mapping[str, Any]) -> np.ndarray:
    """The factors (..., m) of so many entries, for values that are numbers or arrays (...)."""
    each = [np.asarray(values.get(f"{table}.{name}", 1.0), dtype=float) for name in names]
    return np.stack(np.broadcast_arrays(*each), axis=-1) if each else np.ones(1)


def _scaled(cov: np.ndarray, factors: np.ndarray) -> np.ndarray:
    return cov * factors[..., :, None] * factors[..., None, :]


def _by_lanes(each: Sequence[tuple[Callable[..., Any], Any]], states: np.ndarray) -> np.ndarray:
    """The values (..., lanes, m) of states (..., lanes, n), by the function of each lane."""
    if len(each) == 1:
        return each[0][0](states)
    found = [(function(states[..., lanes, :]), lanes) for function, lanes in each]
    values = np.empty((*states.shape[:-1], found[0][0].shape[-1]))
    for some, lanes in found:
        values[..., lanes, :] = some
    return values


@dataclass(frozen=True, eq=False)
class BelievedModel:
    """A model with other process noise, and with other parameters in some lanes.

    Attributes:
        inner: each model with its lanes, an index; Ellipsis for one model of all.
        factors: of the standard deviations of the process noise, (n,) or (lanes, n).
    """

    inner: tuple[tuple[Model, Any], ...]
    factors: np.ndarray

    @property
    def angles(self) -> tuple[int, ...]:
        """The states that are angles."""
        return angles_of(self.inner[0][0])

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., n), or (..., lanes, n) of several models, one step later."""
        each = [(partial(one.transition, control=control, step=step), at) for one, at in self.inner]
        return _by_lanes(each, state)

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) or (lanes, n, n) that a step adds."""
        return _scaled(self.inner[0][0].process_noise_cov(step), self.factors)


@dataclass(frozen=True, eq=False)
class BelievedSensor:
    """A sensor with other noise, and with other parameters in some lanes; as `BelievedModel`."""

    inner: tuple[tuple[Any, Any], ...]
    factors: np.ndarray
    kinds: tuple[str, ...]

    @property
    def gate(self) -> float | None:
        """That of the sensor."""
        return self.inner[0][0].gate

    @property
    def channels(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each entry."""
        return tuple(getattr(self.inner[0][0], "channels", ()))

    @property
    def noise_std(self) -> np.ndarray:
        """Standard deviation (m,) of the noise of each entry."""
        return np.asarray(self.inner[0][0].noise_std) * self.factors

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Readings (..., m) of states (..., n), or with lanes as `BelievedModel.transition`."""
        return _by_lanes([(partial(one.measure, step=step), at) for one, at in self.inner], state)

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The difference of two readings (..., m)."""
        return self.inner[0][0].residual(a, b)

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value (..., m) and noise covariance (..., m, m) of a delivered reading (..., d)."""
        value, cov = self.inner[0][0].interpret(delivered)
        return value, _scaled(cov, self.factors)


def believed(definition: ScenarioDefinition, values: Mapping[str, Any]) -> ScenarioDefinition:
    """The definition whose filters believe in these values, by name: numbers, or arrays (lanes,).

    A delay moves the readings of a log to their own steps; it is a number.
    """

    @lru_cache(maxsize=64)
    def checked(scenario: Scenario) -> Named:
        known = named(definition, scenario)
        for name in values:
            known.found(name)
        return known

    @lru_cache(maxsize=8)
    def bound(scenario: Scenario) -> list[tuple[Model, Sequence[Sensor | None], Any]]:
        """Models and sensors of each set of parameters, and the lanes that have it."""
        given = {n.partition(".")[2]: v for n, v in values.items() if n.startswith(f"{THETA}.")}
        declared = checked(scenario).declared
        if not given or declared is None:
            sensors = [definition.sensor(scenario, node) for node in range(scenario.nodes)]
            return [(definition.model(scenario), sensors, Ellipsis)]
        rows = np.stack(np.broadcast_arrays(*given.values()), axis=-1)
        several, lanes = np.unique(np.atleast_2d(rows), axis=0, return_inverse=True)
        each = [dict(zip(given, row.tolist(), strict=True)) for row in several]
        found = [(declared.bound(one), lanes == place) for place, one in enumerate(each)]
        return [(model, sensors, np.flatnonzero(there)) for (model, sensors), there in found]

    def model(scenario: Scenario) -> Model:
        inner = tuple((one, lanes) for one, _, lanes in bound(scenario))
        return BelievedModel(inner, _factors(Q, checked(scenario).groups, values))

    def sensor(scenario: Scenario, node: int) -> Sensor | None:
        inner = tuple((sensors[node], lanes) for _, sensors, lanes in bound(scenario))
        if inner[0][0] is None:
            return None
        kinds = checked(scenario).kinds[node]
        return BelievedSensor(inner, _factors(R, kinds, values), kinds)

    def sensors(scenario: Scenario) -> Sensor:
        assert definition.sensors is not None, "it is asked for where there are such alone"
        kinds = checked(scenario).kinds[0]
        inner = ((definition.sensors(scenario), Ellipsis),)
        return BelievedSensor(inner, _factors(R, kinds, values), kinds)

    @lru_cache(maxsize=4)
    def plant(scenario: Scenario) -> Any:
        whole: Any = definition.plant(scenario)
        late_s = [
            [values.get(f"{DELAY}.{one}", 0.0) for one in of] for of in checked(scenario).kinds
        ]
        steps = [[round(one / whole.time_step_s) for one in of] for of in late_s]
        return whole.delayed(steps) if any(map(any, steps)) else whole

    has_theta = any(name.startswith(f"{THETA}.") for name in values)
    return definition._replace(
        model=model,
        sensor=sensor,
        sensors=None if definition.sensors is None or has_theta else sensors,
        plant=plant,
    )
