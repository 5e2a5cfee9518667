"""Values that a measurement bus delivers cycle by cycle, for sets over all cycles at once."""

import numpy as np

from concord.features.measurement_bus.measurement_bus import (
    MeasurementBus,
    bid,
    flexray,
    largest_change,
)
from concord.features.sets.filters.lifted_cycle import DeliveredValues, WeightsAtStep


def bus_of_outputs(outputs: int, static_outputs: int, weights: WeightsAtStep) -> MeasurementBus:
    """The bus of so many scalar outputs, the first of them sent in turn from step 0 on.

    `weights` gives Q (outputs - static_outputs,) of those that contend in a step.

    Raises:
        ValueError: `static_outputs` is not in 0..outputs.
    """
    in_turn = np.ones(static_outputs)

    def of_all(step: int) -> tuple[np.ndarray, ...]:
        return tuple(np.concatenate([in_turn, weights(step)])[:, None, None])

    return MeasurementBus((1,) * outputs, flexray(outputs, static_outputs, first=0), of_all)


def delivered(bus: MeasurementBus, static_outputs: int, outputs: np.ndarray) -> DeliveredValues:
    """Send scalar outputs (..., cycles (l + 1), m) over a bus (`bus_of_outputs`) cycle by cycle;
    the values held begin at zero. An output that is NaN is not sent.

    Raises:
        ValueError: the outputs do not fill whole cycles.
    """
    length, steps = static_outputs + 1, outputs.shape[-2]
    if steps % length:
        raise ValueError(f"{steps} steps do not fill cycles of {length}; simulate a multiple of it")
    held = np.zeros((*outputs.shape[:-2], outputs.shape[-1]))
    contending = slice(static_outputs, None)
    in_turn = np.arange(outputs.shape[-1]) < static_outputs
    values, before, winners, limits = [], [], [], []
    for last in range(static_outputs, steps, length):
        held = np.where(in_turn, np.nan, held)
        for step in range(last - static_outputs, last):
            held = bus.transmit(step, outputs[..., step, :], held).received
        sent = bus.transmit(last, outputs[..., last, :], held)
        before.append(held[..., contending])
        # As a receiver computes it, from the values that it has.
        change = sent.received - held
        each = [bid(change[..., [j]], weight) for j, weight in enumerate(bus.weights_at(last))]
        bids = np.where(sent.sent, np.stack(each, -1), -1)[..., contending]
        held = sent.received
        values.append(held)
        largest = bids.max(-1, initial=-1)
        first = bids.argmax(-1) if bids.shape[-1] else np.zeros(held.shape[:-1], int)
        winners.append(np.where((largest < 0) & bool(bids.shape[-1]), -1, first))
        limits.append(largest_change(largest))
    winner, limit = np.stack(winners, -1), np.stack(limits, -1)
    return DeliveredValues(np.stack(values, -2), np.stack(before, -2), winner, limit)
