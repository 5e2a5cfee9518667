"""What of a scenario its faults need to know."""

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from nodes.belief_codec import BeliefCodec
from nodes.faults import Equipment, Faults
from nodes.messages import Array
from scenarios.bus_plan import BusPlan
from scenarios.catalogue import kind_of
from scenarios.links import key_of
from scenarios.rules import rule_of, wire_number
from scenarios.scenario import Scenario

if TYPE_CHECKING:
    from scenarios.setup import Setup


@runtime_checkable
class _Rated(Protocol):
    """A sensor that says how far its raw readings are off."""

    @property
    def noise_std(self) -> Array: ...


@runtime_checkable
class _Uncalibrated(Protocol):
    """One whose raw readings are not the measurement that is made of them."""

    @property
    def delivered_std(self) -> Array: ...


def build_faults(setup: "Setup", plan: BusPlan) -> Faults:
    """What decides of the faults of a run, of which none stands yet."""
    return Faults(key_of(setup.scenario, "faults"), equipment_of(setup, plan))


def equipment_of(setup: "Setup", plan: BusPlan) -> Equipment:
    """What the network of a setup has that can be wrong."""
    scenario, cluster = setup.scenario, plan.cluster
    number, codec = "", None
    if kind_of(scenario.name).wiring is None:
        rule = rule_of(scenario)
        number = "" if rule.share_numbers is None else wire_number(scenario)
        codec = BeliefCodec(len(setup.prior_mean), number) if rule.shares_beliefs else None
    if cluster is None:
        return Equipment(number=number, codec=codec)
    # Both action points are as far from the edge of their slot as clocks may be apart.
    offsets = [cluster.action_point_us]
    if cluster.minislots:
        offsets.append(cluster.minislot_action_point_us)
    return Equipment(cluster.channels, cluster.cycle_us, min(offsets), number, codec)


def spread_of(scenario: Scenario, readings: Array) -> Array:
    """Standard deviations (nodes, r, d) of what sensors deliver; 0 of what is no measurement."""
    kind = kind_of(scenario.name)
    spread = np.zeros(readings.shape)
    for node in range(len(readings)):
        sensor = kind.sensor(scenario, node)
        for number, delivered in enumerate(readings[node]):
            if sensor is None or np.isnan(delivered).all():
                continue
            if isinstance(sensor, _Uncalibrated):
                deviations = sensor.delivered_std
            elif isinstance(sensor, _Rated):
                deviations = np.atleast_1d(sensor.noise_std)
            else:
                deviations = np.sqrt(np.diagonal(sensor.interpret(delivered)[1]))
            known = np.nan_to_num(deviations[: readings.shape[-1]])
            spread[node, number, : len(known)] = known
    return spread
