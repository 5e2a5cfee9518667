"""Equipment: the properties of a scenario's network that its faults need."""

from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np

from concord.bus.bus import Bus, retransmits
from concord.bus.clocks import KeepsClocks
from concord.filters.gaussian import stacked_size
from concord.nodes.faults.active import Equipment, Faults
from concord.nodes.vector_codec import BeliefCodec
from concord.scenarios.catalogue import definition_of
from concord.scenarios.filter_table.filters import models_of
from concord.scenarios.rule_table.rules import rule_of, wire_number
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup, key_of


@runtime_checkable
class _Rated(Protocol):
    """A sensor that says how far its raw readings are off."""

    @property
    def noise_std(self) -> np.ndarray: ...


@runtime_checkable
class _Uncalibrated(Protocol):
    """One whose raw readings are not the measurement that is made of them."""

    @property
    def delivered_std(self) -> np.ndarray: ...


def build_faults(setup: Setup, bus: Bus) -> Faults:
    """Return the faults of a run, none active yet, with the key of their draws."""
    return Faults(key_of(setup.scenario, "faults"), equipment_of(setup, bus))


def equipment_of(setup: Setup, bus: Bus) -> Equipment:
    """Return the equipment of a setup's network that faults can strike."""
    scenario, number, codec = setup.scenario, "", None
    if not definition_of(scenario).wirings:
        rule = rule_of(scenario)
        number = "" if rule.share is None else wire_number(scenario)
        if rule.share is not None and rule.shares_beliefs:
            states, models = len(setup.prior_mean), models_of(scenario.filter)
            origin = definition_of(scenario).origin(scenario)
            form = rule.share.codec(number, states, scenario.nodes, models, origin).form
            codec = BeliefCodec(stacked_size(states, models), number, form)
    clocks, sync = None, ()
    if isinstance(bus, KeepsClocks):
        clocks, sync = partial(bus.clock_errors, scenario.nodes), bus.sync_nodes
    return Equipment(
        bus.channels,
        bus.cycle_us,
        bus.clock_precision_us,
        number,
        codec,
        bus.frame_format.noticed_bits,
        clocks,
        sync,
        scenario.rounds,
        bus.retransmissions if retransmits(bus) else 0,
        setup.neighbours,
        ("missing", "crc") if isinstance(bus, KeepsClocks) and bus.sync_in_frames else (),
    )


def spread_of(scenario: Scenario, readings: np.ndarray) -> np.ndarray:
    """Standard deviations (nodes, r, d) of what sensors deliver; 0 of what is no measurement."""
    definition = definition_of(scenario)
    spread = np.zeros(readings.shape)
    for node in range(len(readings)):
        sensor = definition.sensor(scenario, node)
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
