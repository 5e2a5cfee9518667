"""Figures of the innovations of a run: NIS of each node, tests of each channel, and their cause."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from concord.filters.gaussian import Gaussian
from concord.results.figures.intervals import Interval
from concord.results.figures.network_errors import outside_reasons, outside_steps
from concord.results.innovations.channel_test import (
    ChannelTest,
    channel_test,
    nis_interval,
)
from concord.results.innovations.diagnosis import Channel, Diagnosis, diagnose
from concord.scenarios.catalogue import definition_of
from concord.scenarios.innovations import Innovations
from concord.scenarios.setup import Setup

Bounds = tuple[float, float]


class ChannelFigures(msgspec.Struct, frozen=True):
    """One channel of the readings of a node, in the filter that hears everything.

    Behind a gate the law of innovations is cut, and all figures are relative to the cut law.

    `nis` is the mean normalised innovation squared, 1 if all is right; `mean` that of the
    innovations, in `unit`; `correlation` that of successive ones. The p values are those of
    `channel_test`. Intervals are of 95 %. Figures are None where readings are too few.
    """

    node: int
    reading: int
    channel: int
    name: str
    unit: str
    updates: int
    nis: float | None
    nis_interval: Bounds | None
    mean: float | None
    mean_interval: Bounds | None
    correlation: float | None
    p_mean: float | None
    p_spread: float | None
    p_white: float | None


class NisFigures(msgspec.Struct, frozen=True):
    """Normalised innovations squared per degree of freedom, 1 if all is right.

    `updates` are the readings they come from. `interval` is that of 95 % if they are independent,
    as those of the filter that hears everything are; None without readings.
    """

    updates: int
    nis: float | None
    interval: Bounds | None


class InnovationFigures(msgspec.Struct, frozen=True):
    """Innovations from the first scored step on: of each node's own readings, of all nodes
    together, and of the filter that hears everything, whose channels are tested.

    `outside` is the share of the scored steps for which the model does not hold, by the reason, and
    of any reason under "any". Their innovations do not count.
    """

    nodes: list[NisFigures]
    network: NisFigures
    centralised: NisFigures
    channels: list[ChannelFigures]
    outside: dict[str, float] | None = None


class Outside(NamedTuple):
    """The steps (R, S) for which the model does not hold, and their `shares` of those that count,
    as `InnovationFigures.outside`; None for a model that always holds."""

    steps: np.ndarray
    shares: dict[str, float] | None


def outside_model(setup: Setup, belief: Gaussian, counted: np.ndarray) -> Outside:
    """Where estimates (R, S, n) are outside the model, among the steps that count (R, S)."""
    steps, reasons = outside_steps(setup, belief.mean), outside_reasons(setup, belief.mean)
    if reasons is None:
        return Outside(steps, None)
    each = {"any": steps, **reasons}
    shares = {name: float(there[counted].mean()) for name, there in each.items() if counted.any()}
    return Outside(steps, shares)


def innovation_figures(
    setup: Setup, own: Innovations, heard: Innovations, outside: dict[str, float] | None
) -> tuple[InnovationFigures, Diagnosis]:
    """The figures of innovations (R, S, N, r, m) that were accepted, and what they point to.

    `outside` are the shares of steps that do not count (`InnovationFigures.outside`).
    """
    tests = [
        (channel, channel_test(heard.value[at], heard.cov[(*at, channel.entry)]))
        for channel, at in _channels(setup, heard)
    ]
    found = InnovationFigures(
        [
            _nis(own.nis[..., node, :], own.entries[..., node, :])
            for node in range(own.nis.shape[2])
        ],
        _nis(own.nis, own.entries),
        _nis(heard.nis, heard.entries),
        [_figures(channel, test) for channel, test in tests],
        outside,
    )
    return found, diagnose(tests)


def nis_per_step(innovations: Innovations) -> np.ndarray:
    """NIS per degree of freedom of all nodes in each step (R, S); NaN where none took a reading."""
    total, freedoms = np.nansum(innovations.nis, axis=(2, 3)), innovations.entries.sum(axis=(2, 3))
    return np.where(freedoms > 0, total / np.maximum(freedoms, 1), np.nan)


def _channels(setup: Setup, heard: Innovations) -> list[tuple[Channel, tuple]]:
    """The channels with a reading, and their place in innovations (R, S, N, r, m)."""
    definition, found = definition_of(setup.scenario), []
    there = np.asarray(np.isfinite(heard.value).any(axis=(0, 1)))
    for node, reading, entry in np.argwhere(there).tolist():
        sensor: Any = definition.sensor(setup.scenario, node)
        names: Sequence[tuple[str, str]] = getattr(sensor, "channels", ())
        name, unit = names[entry] if entry < len(names) else (f"channel {entry}", "")
        if there.shape[1] > 1:
            name = f"{name} of reading {reading}"
        channel = Channel(node, reading, entry, name, unit)
        found.append((channel, (slice(None), slice(None), node, reading, entry)))
    return found


def _nis(nis: np.ndarray, entries: np.ndarray) -> NisFigures:
    freedoms, updates = int(entries.sum()), int((entries > 0).sum())
    if not freedoms:
        return NisFigures(0, None, None)
    found = nis_interval(float(np.nansum(nis)), freedoms)
    return NisFigures(updates, found.value, (found.low, found.high))


def _figures(channel: Channel, test: ChannelTest) -> ChannelFigures:
    return ChannelFigures(
        node=channel.node,
        reading=channel.reading,
        channel=channel.entry,
        name=channel.name,
        unit=channel.unit,
        updates=test.updates,
        nis=_known(test.nis.value),
        nis_interval=_bounds(test.nis),
        mean=_known(test.mean.value),
        mean_interval=_bounds(test.mean),
        correlation=_known(test.correlation),
        p_mean=_known(test.p_mean),
        p_spread=_known(test.p_spread),
        p_white=_known(test.p_white),
    )


def _bounds(interval: Interval) -> Bounds | None:
    return None if np.isnan(interval.low) else (interval.low, interval.high)


def _known(value: float) -> float | None:
    return None if np.isnan(value) else value
