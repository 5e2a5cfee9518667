"""Innovations behind a gate, which cuts the chi-square law of what it lets through.

Of m degrees of freedom and a gate q, a sound filter refuses 1 - F_m(q) of its readings. The
normalised innovations squared that are left have the mean m F_{m+2}(q) / F_m(q). Source: the
truncated chi-square law; its mean follows from x f_m(x) = m f_{m+2}(x).
"""

from typing import NamedTuple

import numpy as np

from concord.results.innovations.diagnosis import FALSE_ALARMS
from concord.scenarios.catalogue import definition_of
from concord.scenarios.innovations import Innovations
from concord.scenarios.setup import Setup


class RefusedAtNode(NamedTuple):
    """Readings of a node that came to its gate, those that it refused, and the expected share;
    `is_locked` if so many are refused that chance and the margin do not explain them."""

    node: int
    taken: int
    refused: int
    expected: float
    is_locked: bool


_LOCKED = 5.0
"""So many times the expected share is no slip of a model that is nearly right."""


def mean_behind_gate(entries: np.ndarray, gates: np.ndarray) -> np.ndarray:
    """Return the mean of NIS per degree of freedom behind gates, of so many entries; 1 without."""
    from scipy.special import chdtr

    entries, gates = np.broadcast_arrays(entries, gates)
    found = np.ones(entries.shape)
    cut = np.isfinite(gates) & (entries > 0)
    m, q = entries[cut], gates[cut]
    found[cut] = chdtr(m + 2, q) / chdtr(m, q)
    return found


def accepted(setup: Setup, innovations: Innovations) -> Innovations:
    """The innovations (..., N, r, m) that passed the gates of the sensors, as if there were none.

    Their covariance is that of the law cut at the gate, so that NIS is 1 if all is right.
    """
    gates = gates_of(setup)
    if np.isinf(gates).all():
        return innovations
    refused = innovations.nis > gates[:, None]
    scale = mean_behind_gate(innovations.entries, gates[:, None])
    cov = innovations.cov * scale[..., None, None]
    return Innovations(
        np.where(refused[..., None], np.nan, innovations.value),
        np.where(refused[..., None, None], np.nan, cov),
        np.where(refused, np.nan, innovations.nis / scale),
    )


def refused_by_gates(
    setup: Setup, innovations: Innovations, counted: np.ndarray
) -> list[RefusedAtNode]:
    """Refusals of each gate among own innovations (R, S, N, r, m) in steps that count (R, S)."""
    from scipy.special import bdtrc, chdtrc

    gates, found = gates_of(setup), []
    for node in np.flatnonzero(np.isfinite(gates)).tolist():
        nis = innovations.nis[:, :, node][counted]
        entries = innovations.entries[:, :, node][counted]
        there = entries > 0
        taken, refused = int(there.sum()), int((nis[there] > gates[node]).sum())
        expected = float(chdtrc(entries[there], gates[node]).mean()) if taken else 0.0
        chance = bdtrc(refused - 1, taken, expected) if refused else 1.0
        locked = taken > 0 and chance < FALSE_ALARMS / len(gates)
        locked &= refused > max(_LOCKED * expected, 0.5) * taken
        found.append(RefusedAtNode(node, taken, refused, expected, bool(locked)))
    return found


def gates_of(setup: Setup) -> np.ndarray:
    """Greatest NIS (N,) that the filter of each node takes; infinite without a gate."""
    definition = definition_of(setup.scenario)
    sensors = (definition.sensor(setup.scenario, node) for node in range(setup.scenario.nodes))
    gates = [None if sensor is None else sensor.gate for sensor in sensors]
    return np.array([np.inf if gate is None else gate for gate in gates])
