"""Frames and shares that ask for static slots, as a TOML table."""

import tomllib
from math import inf
from pathlib import Path
from typing import Literal

import msgspec

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.share_frames import PREFIX_BYTES, payload_lengths
from concord.bus.flexray.slot_table import REPETITIONS

ChannelWish = Literal["A", "B", "AB", "any"]


class DemandError(ValueError):
    """A demand that no schedule of a cluster meets; names the values and the cure."""


class FrameDemand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A frame of a node, requested every `period_us`, whose last bit comes `deadline_us` after.

    With `offset_us` the requests come at that time of the bus and every period after it; without,
    at any time, a period apart at least. `channel` "any" leaves the channel open.
    """

    node: int
    payload_bytes: int
    period_us: float
    deadline_us: float
    offset_us: float | None = None
    channel: ChannelWish = "any"


class ShareDemand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A share of a node, of so many bytes, that no receiver may hold for longer than `age_us`.

    Its frames are all sent in one cycle. Its error grows by `growth` in each microsecond of age.
    """

    node: int
    share_bytes: int
    age_us: float
    growth: float = 1.0
    channel: ChannelWish = "any"


class Demand(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All frames and shares of a bus."""

    frames: tuple[FrameDemand, ...] = ()
    shares: tuple[ShareDemand, ...] = ()


class Item(msgspec.Struct, frozen=True):
    """A demand in the terms of a cluster.

    Its frames, one for each of `payloads`, are all sent in one cycle out of so many: one of
    `repetitions`. `channels` are the ways to send it.
    """

    name: str
    node: int
    payloads: tuple[int, ...]
    repetitions: tuple[int, ...]
    channels: tuple[str, ...]
    growth: float = 0.0
    period_us: float | None = None
    deadline_us: float = inf
    offset_us: float | None = None

    @property
    def copies(self) -> int:
        """Frames in each of its cycles."""
        return len(self.payloads)


def read_demand(path: Path) -> Demand:
    """Read a table of frames and shares.

    Raises:
        DemandError: the file cannot be read, or is no such table.
    """
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Demand)
    except OSError as error:
        raise DemandError(f"{path}: cannot be read ({error.strerror}); name a table") from None
    except (tomllib.TOMLDecodeError, UnicodeError, msgspec.ValidationError) as error:
        raise DemandError(f"{path}: is no table of frames and shares: {error}") from None


def items_of(demand: Demand, cluster: Cluster) -> list[Item]:
    """Return the demands in the terms of a cluster.

    Raises:
        DemandError: there is none, or one that no static slot of the cluster meets.
    """
    if not (demand.frames or demand.shares):
        raise DemandError("the table asks for nothing; add [[frames]] or [[shares]]")
    return [
        *(_frame(one, place, cluster) for place, one in enumerate(demand.frames, 1)),
        *(_share(one, place, cluster) for place, one in enumerate(demand.shares, 1)),
    ]


def _frame(frame: FrameDemand, place: int, cluster: Cluster) -> Item:
    name = f"frame {place} of node {frame.node}"
    _check_values(name, frame, ("period_us", "deadline_us"))
    limit = cluster.static_payload_bytes
    if not 0 <= frame.payload_bytes <= limit or frame.payload_bytes % 2:
        raise DemandError(
            f"{name}: payload_bytes is {frame.payload_bytes}, but a static frame of cluster "
            f"{cluster.name!r} carries an even number from 0 to {limit}; split the frame"
        )
    if frame.period_us < cluster.cycle_us * (1 - 1e-9):
        raise DemandError(
            f"{name}: period_us is {frame.period_us:g}, but a slot comes once in a cycle of "
            f"{cluster.cycle_us:g} us; use a longer period, or a shorter cycle"
        )
    known = _repetitions(cluster)
    if frame.offset_us is None:
        overhead_us = cluster.action_point_us + cluster.frame_us(limit)
        fitting = _within(name, frame.deadline_us, overhead_us, cluster)
        fitting = [one for one in fitting if one * cluster.cycle_us <= frame.period_us * (1 + 1e-9)]
        chosen = (max(fitting),)
    else:
        cycles = frame.period_us / cluster.cycle_us
        if frame.offset_us < 0 or not any(abs(cycles - one) < 1e-6 for one in known):
            raise DemandError(
                f"{name}: with offset_us {frame.offset_us:g} (0 or more) the period must be "
                f"{', '.join(map(str, known))} cycles of {cluster.cycle_us:g} us, but is "
                f"{cycles:g}; correct it, or leave offset_us out"
            )
        chosen = (round(cycles),)
    return Item(
        name, frame.node, (frame.payload_bytes,), chosen, _channels(name, frame.channel, cluster),
        0.0, frame.period_us, frame.deadline_us, frame.offset_us,
    )  # fmt: skip


def _share(share: ShareDemand, place: int, cluster: Cluster) -> Item:
    name = f"share {place} of node {share.node}"
    _check_values(name, share, ("age_us",))
    if share.share_bytes < 1 or not 0 <= share.growth < inf:
        raise DemandError(
            f"{name}: share_bytes is {share.share_bytes} and growth {share.growth:g}; use at least "
            "one byte, and a growth from 0 on"
        )
    try:
        payloads = payload_lengths(share.share_bytes, cluster.static_payload_bytes)
    except ValueError:
        raise DemandError(
            f"{name}: static frames of cluster {cluster.name!r} carry "
            f"{cluster.static_payload_bytes} bytes, too few for a share, which takes "
            f"{PREFIX_BYTES} and more in each; use another cluster"
        ) from None
    if len(payloads) > cluster.static_slots:
        raise DemandError(
            f"{name}: it takes {len(payloads)} slots in a cycle, but cluster {cluster.name!r} has "
            f"{cluster.static_slots}; use shorter shares, or longer static frames"
        )
    return Item(
        name,
        share.node,
        payloads,
        tuple(_within(name, share.age_us, share_overhead_us(cluster, len(payloads)), cluster)),
        _channels(name, share.channel, cluster),
        growth=share.growth,
        deadline_us=share.age_us,
    )


def share_overhead_us(cluster: Cluster, frames: int) -> float:
    """Return the longest time from the first slot of a share to the last bit of its last frame."""
    span_us = (cluster.static_slots - 1) * cluster.static_slot_us if frames > 1 else 0.0
    return span_us + cluster.action_point_us + cluster.frame_us(cluster.static_payload_bytes)


def _within(name: str, limit_us: float, overhead_us: float, cluster: Cluster) -> list[int]:
    """Return the repetitions with which a request that has just missed its slot is in time."""
    fitting = [
        one
        for one in _repetitions(cluster)
        if one * cluster.cycle_us + overhead_us <= limit_us * (1 + 1e-12)
    ]
    if not fitting:
        raise DemandError(
            f"{name}: it must arrive within {limit_us:g} us, but a request that has just missed "
            f"its slot waits for a cycle of {cluster.cycle_us:g} us and "
            f"{overhead_us:.1f} us more; allow {cluster.cycle_us + overhead_us:.1f} us, use a "
            "shorter cycle, or state offset_us of a frame"
        )
    return fitting


def _repetitions(cluster: Cluster) -> list[int]:
    return [one for one in REPETITIONS if cluster.number_of_cycles % one == 0]


def _channels(name: str, channel: ChannelWish, cluster: Cluster) -> tuple[str, ...]:
    if channel == "any":
        return tuple(cluster.channels)
    if not set(channel) <= set(cluster.channels):
        raise DemandError(
            f"{name}: channel is {channel}, but cluster {cluster.name!r} has {cluster.channels}"
        )
    return (channel,)


def _check_values(name: str, demand: FrameDemand | ShareDemand, fields: tuple[str, ...]) -> None:
    if demand.node < 0:
        raise DemandError(f"{name}: nodes are numbered from 0")
    for field in fields:
        if not 0 < getattr(demand, field) < inf:
            raise DemandError(f"{name}: {field} is {getattr(demand, field)}; use a positive number")
