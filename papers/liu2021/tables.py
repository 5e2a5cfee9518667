"""Tables I to III of Liu et al. (2021), the gains of the first three cycles, beside ours.

The rule (5) of the paper gives other winners than the tables need (output 4 three times), so they
are forced here. The held values are known exactly from the second cycle on, which leaves the gain
on them open; a shape a hair larger settles it as the tables do.
"""

from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.measurement_bus import MeasurementBus
from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.delivered import delivered
from concord.features.sets.filters.bus_readings import augmented
from concord.features.sets.filters.ellipsoid import Ellipsoid, squared
from concord.filters.linalg import join_columns
from concord.papers.liu2021.runs import BUS, HELD, PLANT, G, N, printed_step

WINNER_OF_TABLES = 1
_HAIR = 1e-7

# Rows of the three gains, two in a line.
_PUBLISHED = """
    0.1268, -0.1483, -0.0043, -0.0213; -0.0105, 0.0560, 0.0025, 0.0088;
    0.0269, -0.0011, -0.0581, -0.0302; 0.0065, 0.4176, 0.0047, 0.1192;
    0.1358, -0.0864, -0.0044, -0.0220; 0, 0.6882, -0.0024, -0.0081;
    0.0169, 0.5686, 0.0430, 0.0183; 0, -0.0069, 0.0011, 0.1241;
    0.1839, -0.0325, 0.0070, -0.0432; -0.0159, 0.1314, 0.0120, -0.0100;
    0.0122, -0.5265, -0.0267, -0.0383; 0.0026, 0.0913, -0.0011, 0.1312;
    0, 0, 1, 0; 0, 0, 0, 1;
    0.1539, 1.509, -0.0022, -0.0379; 0, 0.6249, 0, -0.0025;
    -0.0630, -2.4464, -0.0471, 0.0291; 0.0213, 1.9819, 0, 0.0174;
    0.2325, 5.4709, -0.0109, -0.2396; 0.0016, 1.9455, -0.0049, -0.1175;
    0.1007, 4.5693, 0.0316, -0.1652; 0, 0.0685, 0, 0.1215;
    0.2674, 6.9222, -0.0150, -0.3128; -0.0123, 0.9621, -0.0064, -0.0593;
    -0.0276, -2.0192, -0.0311, 0.0450; 0.0060, 0.1142, 0.0055, 0.1261;
    0, 0, 1, 0; 0, 0, 0, 1;
    0.1211, -0.2321, 0.0061, -0.0670; -0.0116, 0.0122, 0.0038, 0.0073;
    0.0174, 0.4863, -0.1212, 0.0383; 0.0067, 0.3423, 0.0095, 0.1154;
    0.1764, 0.4361, 0.0038, -0.0986; -0.0066, 0.3458, -0.0024, 0.0032;
    0.0217, 0.0786, 0.0941, -0.0544; 0, -0.0016, 0, 0.1246;
    0.1737, 0.5230, 0.0027, -0.0959; -0.0225, 0.0565, 0.0012, 0.0058;
    0.0164, 0.0119, -0.0731, 0.0139; 0.0031, 0.0157, 0.0085, 0.1215;
    0, 0, 1, 0; 0, 0, 0, 1;
"""
PUBLISHED = np.array(
    [row.split(",") for row in _PUBLISHED.split(";")[:-1]], dtype=np.float64
).reshape(3, -1, 4)


class GainDifference(NamedTuple):
    """Of a gain to the printed one: the largest of an entry, and relative in the Frobenius norm."""

    largest: float
    relative: float


class _Forced(MeasurementBus):
    """The bus on which the winner of the tables wins always."""

    def bids(self, slot: int, measurement: np.ndarray, received: np.ndarray) -> np.ndarray:
        sensors = np.arange(len(self.sizes))
        return np.where(sensors == liu2021.STATIC_OUTPUTS + WINNER_OF_TABLES, 1, 0)


def gains_of_tables() -> np.ndarray:
    """L(t_0), L(t_1), L(t_2) (3, 14, 4) on the paper's noise, with output 4 winning each time."""
    cycles, size = len(PUBLISHED), G * N + HELD
    _, outputs = liu2021.SYSTEM.simulate(liu2021.INITIAL_STATE, liu2021.printed_noise(cycles * G))
    forced = _Forced(BUS.sizes, BUS.schedule, BUS.weights)
    received = delivered(forced, liu2021.STATIC_OUTPUTS, outputs)
    kept, gains = Ellipsoid(np.zeros(size), np.eye(size)), []
    for cycle in range(cycles):
        model = augmented(PLANT, received, cycle)
        step = printed_step(kept, model, received.values[cycle])
        gains.append(step.gain)
        hair = np.sqrt(_HAIR) * np.eye(size)
        kept = Ellipsoid(step.after.centre, squared(join_columns(step.after.factor, hair)))
    return np.array(gains)


def difference(ours: np.ndarray, printed: np.ndarray) -> GainDifference:
    """Of two gains (14, 4)."""
    apart = ours - printed
    norms = np.linalg.norm(apart) / np.linalg.norm(printed)
    return GainDifference(float(np.abs(apart).max()), float(norms))
