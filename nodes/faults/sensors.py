"""Faults of sensors: change the readings where the environment reads them."""

import numpy as np

from concord.nodes.faults.active import EVERYBODY, Faults, hangs

# Entries of readings are told apart by so much in a draw.
_ENTRIES = 1 << 8


def delivered(
    faults: Faults, step: int, readings: np.ndarray, last: np.ndarray | None, spread: np.ndarray
) -> np.ndarray:
    """Return the readings that the sensors of all nodes deliver.

    Args:
        readings: (nodes, r, d), what they would if nothing was wrong.
        last: what they delivered in the step before; None in the first.
        spread: (nodes, r, d), standard deviations; 0 of entries that no sensor gets wrong.

    Returns:
        (nodes, r, d).
    """
    changed = readings.copy()
    for node in range(len(readings)):
        if bias := faults.at("bias", step, node):
            changed[node] += bias[0] * spread[node]
        if outlier := faults.at("outlier", step, node):
            changed[node] += _outliers(faults, step, node, spread[node], *outlier)
        if faults.at("stuck", step, node) and last is not None:
            changed[node] = last[node]
        dropout = faults.at("dropout", step, node)
        drops = dropout and faults.draw("dropout", step, node, EVERYBODY) < dropout[0]
        if drops or hangs(faults, step, node):
            changed[node] = np.nan
    return changed


def _outliers(
    faults: Faults, step: int, node: int, spread: np.ndarray, probability: float, size: float
) -> np.ndarray:
    """Return the addition to a node's readings (r, d); it hits or spares each reading whole."""
    added = np.zeros_like(spread)
    for number, entries in enumerate(spread):
        if faults.draw("outlier", step, node, number) < probability:
            for entry, deviation in enumerate(entries):
                sign = faults.draw("outlier sign", step, node, number * _ENTRIES + entry)
                added[number, entry] = size * deviation * (1 if sign < 0.5 else -1)
    return added
