"""The truth of a plant of the user's own, which may differ from what the filters believe."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.own_motion import Inputs, bound
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor, TrueSensor, joined, require_sensor
from concord.plants.own_trials import require_lanes, within_a_turn
from concord.plants.placement import Draws, GeneratorFor, standard_draws

Sensed = OwnSensor | Sequence[OwnSensor] | None
"""The sensors of a node: one, several, or none."""
AS_BELIEVED = TrueSensor()


@dataclass(frozen=True, eq=False, kw_only=True)
class TruePlant:
    """A plant and its sensors as they really are, where the filters believe something else.

    Each field has the meaning that it has in `OwnPlant`; None for what the filters believe.

    Attributes:
        f, dynamics, inputs, Q, mean, cov: of the plant. The number of states is that of the belief.
        sensors: what each sensor really does, in the order and shape of `own_scenario`'s; None for
            one that is as believed. Rates, delays and missing readings are those of the belief.
    """

    f: Callable[..., ArrayLike] | None = None
    dynamics: Callable[..., ArrayLike] | None = None
    inputs: Inputs = None
    Q: ArrayLike | None = None
    mean: ArrayLike | None = None
    cov: ArrayLike | None = None
    sensors: Sequence[TrueSensor | Sequence[TrueSensor | None] | None] | None = None

    def plant_of(self, believed: OwnPlant) -> OwnPlant:
        """The plant that really moves, where the filters believe in another.

        Raises:
            ValueError: as `OwnPlant`, or another number of states.
        """
        fields = ("f", "dynamics", "inputs", "Q", "mean", "cov")
        changed = {name: getattr(self, name) for name in fields if getattr(self, name) is not None}
        if "f" in changed or "dynamics" in changed:
            changed = {"f": None, "dynamics": None} | changed
        try:
            true = replace(believed, **changed)
        except ValueError as error:
            raise ValueError(f"truth: {error}") from None
        if true.states != believed.states:
            raise ValueError(
                f"truth: it has {true.states} states and the filters {believed.states}; give both "
                "the same, so that estimates can be compared with the truth"
            )
        return true


@dataclass(frozen=True)
class NodeSensors:
    """The sensors of a node, one after the other in its reading: what it believes of each, and what
    each does."""

    believed: tuple[OwnSensor, ...]
    real: tuple[TrueSensor, ...]

    @cached_property
    def sensor(self) -> OwnSensor:
        """The sensors as one, as the node believes in them."""
        return joined(self.believed)

    @cached_property
    def truth(self) -> OwnSensor:
        """The sensors as one, as they are."""
        return joined([true.of(one) for one, true in zip(self.believed, self.real, strict=True)])

    @cached_property
    def bias(self) -> np.ndarray:
        """Of each entry, (m,)."""
        pairs = zip(self.believed, self.real, strict=True)
        return np.concatenate([np.broadcast_to(true.bias, one.entries) for one, true in pairs])

    def require_sound(self, mean: np.ndarray) -> None:
        """Refuse a bias of another length, and a true h that has other shapes near a mean.

        Raises:
            ValueError: naming which.
        """
        _ = self.sensor, self.truth
        for one, true in zip(self.believed, self.real, strict=True):
            if true.h is not None:
                require_lanes("truth: h(x)", true.h, mean, one.entries)
            if np.shape(true.bias) not in ((), (one.entries,)):
                raise ValueError(
                    f"truth: bias {true.bias} has the shape {np.shape(true.bias)}; give one "
                    f"number, or {one.entries}, one for each entry"
                )

    @cached_property
    def factor(self) -> np.ndarray:
        """A factor (m, m) of the covariance of the noise, sensor by sensor."""
        factor, first = np.zeros_like(self.truth.noise_cov), 0
        for one, true in zip(self.believed, self.real, strict=True):
            own = slice(first, first + one.entries)
            factor[own, own] = _factor(true.of(one).noise_cov)
            first += one.entries
        return factor

    def errors(self, noise: np.ndarray) -> np.ndarray:
        """Errors (..., m) of drawn noise (..., m); NaN where a sensor does not read."""
        return np.where(np.isnan(noise), np.nan, np.nan_to_num(noise) @ self.factor.T) + self.bias

    def drawn(
        self, normals: np.ndarray, node: int, generator_for: GeneratorFor, time_step_s: float
    ) -> None:
        """Turn normals (steps, d) into this node's noise; NaN where a sensor does not read.

        Draws beside the normals have streams of their own, so other sensors err as before.
        """
        first = 0
        for place, (one, true) in enumerate(zip(self.believed, self.real, strict=True)):
            own = normals[:, first : first + one.entries]
            if true.outlier_share or np.isfinite(true.degrees_of_freedom):
                own[:] = true.shaped(own, generator_for(f"tails {place}", node))
            read = one.due(len(own), time_step_s)
            if one.missing:
                luck = generator_for(f"missing {place}", node).random(len(own))
                read = read & (luck >= one.missing)
            own[~read] = np.nan
            first += one.entries


@dataclass(frozen=True, eq=False)
class OfOwnPlant:
    """Base of what stands for an own plant in a network: its time step and its states."""

    plant: OwnPlant

    @property
    def time_step_s(self) -> float:
        """Sampling time."""
        return self.plant.time_step_s

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.plant.names

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of the states; "" where the user named none."""
        return self.plant.units


@dataclass(frozen=True, eq=False)
class OwnTruth(OfOwnPlant):
    """The truth of a plant, seen by the sensors of each node; None for a blind node.

    Attributes:
        plant: that moves.
        nodes: the sensors of each.
        believed: the plant of the filters; None for `plant`.
    """

    nodes: tuple[NodeSensors | None, ...]
    believed: OwnPlant | None = None

    @cached_property
    def _entries(self) -> int:
        return max((one.sensor.entries for one in self.nodes if one is not None), default=1)

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        return _factor(self.plant.prior_cov), _factor(self.plant.noise_cov)

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run."""
        n = self.plant.states
        draws = standard_draws(generator_for, n, n, (len(self.nodes), 1, self._entries), steps)
        for node, sensors in enumerate(self.nodes):
            if sensors is not None:
                own = draws.measurement[:, node, 0]
                sensors.drawn(own, node, generator_for, self.time_step_s)
        return draws

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., n), prior mean (..., n) and prior cov (n, n) for noise (..., n)."""
        prior = self.believed or self.plant
        mean = np.broadcast_to(prior.prior_mean, noise.shape).copy()
        return self.plant.prior_mean + noise @ self._factors[0].T, mean, prior.prior_cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """True states (..., n) one step later, for noise (..., n)."""
        return self.plant.transition(state, control, step) + noise @ self._factors[1].T

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Readings (..., nodes, 1, d) of states (..., n); NaN where a node has no such entry."""
        readings = np.full(noise.shape, np.nan)
        for node, sensors in enumerate(self.nodes):
            if sensors is not None:
                sensor, m = sensors.truth, sensors.sensor.entries
                reading = sensor.measure(state, step) + sensors.errors(noise[..., node, 0, :m])
                readings[..., node, 0, :m] = within_a_turn(reading, sensor.angles)
        return readings

    def sensor(self, node: int) -> OwnSensor | None:
        """The sensors of a node as it believes in them; None for a blind node."""
        sensors = self.nodes[node]
        return None if sensors is None else sensors.sensor

    def late_steps(self, node: int) -> int:
        """After how many steps a node has its readings, which wait for the last sensor of it."""
        sensors = self.nodes[node]
        each = () if sensors is None else sensors.believed
        return max((one.late_steps(self.time_step_s) for one in each), default=0)

    @property
    def irregular(self) -> str:
        """Why readings are no fixed function of states and normals; empty where they are one."""
        for sensors in self.nodes:
            pairs = () if sensors is None else zip(sensors.believed, sensors.real, strict=True)
            for one, true in pairs:
                if one.every_s is not None or one.start_s or one.missing:
                    return "a sensor does not read in every step"
                if true.outlier_share or np.isfinite(true.degrees_of_freedom):
                    return "the noise of a sensor is not normal"
        return ""

    @property
    def gated(self) -> bool:
        """Whether a late sensor has a gate."""
        return any(
            one.gate is not None and one.delay_s > 0
            for sensors in self.nodes
            for one in (() if sensors is None else sensors.believed)
        )

    def require_inputs(self, steps: int) -> None:
        """Refuse more steps than the inputs last.

        Raises:
            ValueError: with how many there are.
        """
        for plant in (self.plant, self.believed or self.plant):
            most = plant.motion.most_steps
            if most is not None and steps > most:
                raise ValueError(
                    f"--steps {steps}: inputs has {most - 1} rows, enough for {most} steps; ask "
                    "for fewer, or give more inputs"
                )

    def positions(self, step: int) -> np.ndarray | None:
        """Return the nodes' places (nodes, 2) in m; None where the user named none."""
        places = self.plant.places
        if places is None:
            return None
        if len(places) != len(self.nodes):
            raise ValueError(
                f"positions of shape {places.shape}: must be ({len(self.nodes)}, 2), a place for "
                "each node"
            )
        return places


def sensors_of_nodes(
    plant: OwnPlant, sensors: Sequence[Sensed], truth: TruePlant | None = None
) -> tuple[NodeSensors | None, ...]:
    """The sensors that a user names, as those of the first nodes.

    Raises:
        ValueError: no sensor at all, one that cannot read the states of the plant, or a truth that
            is not in the shape of the sensors.
    """
    if not isinstance(sensors, Sequence) or isinstance(sensors, str):
        raise ValueError(
            f"sensors of type {type(sensors).__name__}: must be a list, such as "
            "[OwnSensor(...), None]"
        )
    of_nodes = [_several(place, one) for place, one in enumerate(sensors)]
    if not any(of_nodes):
        raise ValueError("sensors: none of the nodes has one; give at least one OwnSensor")
    true = None if truth is None else truth.sensors
    if true is not None and not isinstance(true, Sequence):
        raise ValueError(
            f"truth: sensors of type {type(true).__name__}: must be a list with an entry for each "
            "node, such as [TrueSensor(...), None]"
        )
    real = [None] * len(sensors) if true is None else list(true)
    if len(real) != len(sensors):
        raise ValueError(
            f"truth: sensors has {len(real)} entries for {len(sensors)} nodes; give one for each, "
            "None for what is as believed"
        )
    nodes, kinds = [], _kinds([one for own in of_nodes for one in own])
    for place, (own, others) in enumerate(zip(of_nodes, real, strict=True)):
        reals = others if isinstance(others, Sequence) else (others,) * max(1, len(own))
        if not own and any(reals):
            raise ValueError(
                f"truth: entry {place} of sensors is a TrueSensor, and node {place} has no sensor; "
                "give None for it"
            )
        if own and len(reals) != len(own):
            raise ValueError(
                f"truth: entry {place} of sensors has {len(reals)} and the node {len(own)}; give "
                "one for each"
            )
        own = tuple(
            replace(one, h=bound("h", one.h, plant.values), kinds=kinds[id(one)]) for one in own
        )
        for one in own:
            require_sensor(one, plant.prior_mean, plant.prior_cov, plant.angles)
            _require_rate(one, plant.time_step_s)
        believed = tuple(replace(one, h=plant.of_turned(one.h)) for one in own)
        each = tuple(_turned(one or AS_BELIEVED, plant) for one in reals)
        of_node = NodeSensors(believed, each) if own else None
        if of_node is not None:
            of_node.require_sound(plant.prior_mean)
        nodes.append(of_node)
    return tuple(nodes)


def _kinds(sensors: Sequence[OwnSensor]) -> dict[int, tuple[str, ...]]:
    """The kind of each entry of each sensor, by its id: its name, or the number of a sensor without
    one among all that differ."""
    each = {id(one): one for one in sensors}
    return {
        key: one.kinds or (one.name or f"sensor{place}",) * one.entries
        for place, (key, one) in enumerate(each.items())
    }


def _turned(true: Any, plant: OwnPlant) -> TrueSensor:
    if not isinstance(true, TrueSensor):
        raise ValueError(
            f"truth: sensors has an entry of type {type(true).__name__}; give a TrueSensor, or "
            "None for one that is as believed"
        )
    return true if true.h is None else replace(true, h=plant.of_turned(true.h))


def _several(place: int, given: Any) -> tuple[OwnSensor, ...]:
    several = () if given is None else given if isinstance(given, tuple | list) else (given,)
    for one in several:
        if not isinstance(one, OwnSensor):
            raise ValueError(
                f"sensors: entry {place} is of type {type(one).__name__}; it must be an "
                "OwnSensor, a list of them, or None for a blind node"
            )
    return tuple(several)


def _require_rate(sensor: OwnSensor, time_step_s: float) -> None:
    if sensor.every_s is not None and sensor.every_s < time_step_s * (1 - 1e-9):
        raise ValueError(
            f"every_s {sensor.every_s:g}: a sensor reads once in a step of {time_step_s:g} s at "
            "most; leave every_s out, or lower the plant's time_step_s"
        )


def _factor(cov: np.ndarray) -> np.ndarray:
    """A factor of a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0))
