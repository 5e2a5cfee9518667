"""The configuration of one FlexRay cluster: every timing parameter, and what follows from them.

Names are the ones people read; `PARAMETERS` gives each parameter's name in the
FlexRay protocol specification (2.1, 3.0.1), whose ranges and constraints a `Cluster` always meets.
"""

import math
from typing import Literal

import msgspec

from concord.bus.flexray.frame import OVERHEAD_BYTES


class ClockParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The parameters by which the nodes of a cluster start up and keep their clocks together.

    None, or no slots: the source does not state the parameter, and no rule looks at it.
    `sync_slots` are the key slots of the sync nodes; nodes with a slot in `startup_slots` may also
    start the cluster. The other values are those of the cluster, or the widest of any node.
    """

    sync_slots: tuple[int, ...] = ()
    startup_slots: tuple[int, ...] = ()
    sync_nodes_most: int | None = None
    cold_start_attempts: int | None = None
    listen_noise: int | None = None
    passive_after_cycle_pairs: int | None = None
    halt_after_cycle_pairs: int | None = None
    drift_damping_microticks: int | None = None
    precision_us: float | None = None
    propagation_delay_us: float | None = None
    offset_correction_us: float | None = None
    offset_correction_start_macroticks: int | None = None
    offset_correction_microticks: int | None = None
    rate_correction_microticks: int | None = None
    drift_microticks: int | None = None
    listen_timeout_microticks: int | None = None
    startup_range_microticks: int | None = None


Channels = Literal["A", "B", "AB"]
"""The channels that a cluster or a slot uses; AB sends the same frame on both."""

Segment = Literal["static", "dynamic"]
"""The parts of a communication cycle in which frames are sent."""

CHANNEL_IDLE_BITS = 11
"""High bits by which a receiver sees the end of a frame (cChannelIdleDelimiter)."""
COLLISION_AVOIDANCE_BITS = 30
"""Low bits of the collision avoidance and media test symbols (cdCAS)."""
TRAILING_BITS = 1
"""Shortest low part of a dynamic trailing sequence."""
CLOCK_DEVIATION = 0.0015
"""Largest deviation of a node's clock (cClockDeviationMax)."""


class ClusterParameters(ClockParameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The parameters of a FlexRay cluster, unchecked, and what follows from them.

    Times and counts of a cycle (microticks, macroticks, microseconds) are all stated, as in a
    FlexRay controller and in FIBEX, and checked against each other.
    """

    name: str
    channels: Channels = "A"
    bit_rate_mbps: float = 10.0
    cycle_us: float
    macroticks_per_cycle: int
    macrotick_us: float
    microtick_us: float = 0.025
    microticks_per_cycle: int
    number_of_cycles: int = 64
    static_slots: int
    static_slot_macroticks: int
    action_point_macroticks: int
    static_payload_words: int
    minislots: int
    minislot_macroticks: int
    minislot_action_point_macroticks: int
    dynamic_slot_idle_phase_minislots: int = 0
    dynamic_payload_words: int
    latest_transmission_minislot: int
    symbol_window_macroticks: int = 0
    network_idle_time_macroticks: int
    transmission_start_bits: int = 9

    @property
    def bit_us(self) -> float:
        """Duration of one bit on the wire (gdBit)."""
        return 1.0 / self.bit_rate_mbps

    @property
    def cycle_time_s(self) -> float:
        """Duration of one communication cycle in seconds."""
        return self.cycle_us * 1e-6

    @property
    def static_slot_us(self) -> float:
        return self.static_slot_macroticks * self.macrotick_us

    @property
    def minislot_us(self) -> float:
        return self.minislot_macroticks * self.macrotick_us

    @property
    def action_point_us(self) -> float:
        """From the beginning of a static slot to the first bit of its frame."""
        return self.action_point_macroticks * self.macrotick_us

    @property
    def minislot_action_point_us(self) -> float:
        """From the beginning of a dynamic slot to the first bit of its frame."""
        return self.minislot_action_point_macroticks * self.macrotick_us

    @property
    def static_payload_bytes(self) -> int:
        """Payload of every static frame (gPayloadLengthStatic)."""
        return 2 * self.static_payload_words

    @property
    def dynamic_payload_bytes(self) -> int:
        """Largest payload of a dynamic frame (pPayloadLengthDynMax)."""
        return 2 * self.dynamic_payload_words

    @property
    def first_dynamic_id(self) -> int:
        """Frame ID of the first dynamic slot: the slot counter of the static segment goes on."""
        return self.static_slots + 1

    @property
    def action_point_difference_macroticks(self) -> int:
        """adActionPointDifference: lets the action points of both segments lie on one grid."""
        if self.minislots == 0:
            return 0
        return max(0, self.action_point_macroticks - self.minislot_action_point_macroticks)

    @property
    def dynamic_segment_start_us(self) -> float:
        """Beginning of the first minislot, from the beginning of the cycle."""
        static_macroticks = self.static_slots * self.static_slot_macroticks
        return (static_macroticks + self.action_point_difference_macroticks) * self.macrotick_us

    def slot_start_us(self, slot: int) -> float:
        """Beginning of a static slot (1 is the first), from the beginning of the cycle."""
        if not 1 <= slot <= self.static_slots:
            raise ValueError(
                f"cluster {self.name!r} has no static slot {slot}: they are 1..{self.static_slots}"
            )
        return (slot - 1) * self.static_slot_us

    def minislot_start_us(self, minislot: int) -> float:
        """Beginning of a minislot (1 is the first), from the beginning of the cycle."""
        return self.dynamic_segment_start_us + (minislot - 1) * self.minislot_us

    def frame_bits(self, payload_bytes: int) -> int:
        """Bits of a frame on the wire from the first of TSS to the last of FES.

        TSS + FSS + 10 for each byte of header, payload and frame CRC (a BSS before each) + FES.
        """
        coded = 10 * (OVERHEAD_BYTES + payload_bytes)
        return self.transmission_start_bits + 1 + coded + 2

    def frame_us(self, payload_bytes: int) -> float:
        """Duration of a frame on the wire, without the trailing sequence of a dynamic frame."""
        return self.frame_bits(payload_bytes) * self.bit_us

    def static_frame_macroticks(self, payload_bytes: int) -> int:
        """Macroticks that a static frame needs where its sender's clock is slow and the receiver's
        fast: its bits, the idle bits after it, and the action point offset on either side.

        FlexRay 2.1, constraint 12.
        """
        bits = self.frame_bits(payload_bytes) + CHANNEL_IDLE_BITS
        return 2 * self.action_point_macroticks + self._slow_macroticks(bits)

    def symbol_window_least_macroticks(self) -> int:
        """Macroticks that a media test symbol needs (FlexRay 2.1, constraint 16)."""
        bits = self.transmission_start_bits + COLLISION_AVOIDANCE_BITS + CHANNEL_IDLE_BITS
        return 2 * self.action_point_macroticks + self._slow_macroticks(bits)

    def dynamic_slot_minislots(self, payload_bytes: int) -> int:
        """Minislots of a dynamic slot: the frame with a trailing sequence up to the next action
        point, the rest of that minislot, and the idle phase.

        Right for every consecutive pair of dynamic frames in the recording of a car's bus. The
        `flexray-adapter` preset agrees: 163 minislots, 16-byte frames, pLatestTx 157 = 163 - 7 + 1.
        """
        bits = self.frame_bits(payload_bytes) + TRAILING_BITS
        frame = _ceiling(bits * self.bit_us / self.minislot_us)
        return frame + 1 + self.dynamic_slot_idle_phase_minislots

    def dynamic_slot_most_minislots(self, payload_bytes: int) -> int:
        """Minislots of a dynamic slot where the sender's clock is slow and the receiver's fast.

        FlexRay 2.1, constraint 15.
        """
        bits = self.frame_bits(payload_bytes) + TRAILING_BITS
        frame = _ceiling(self._slow_us(bits) / (self.minislot_us * (1 - CLOCK_DEVIATION)))
        return frame + 1 + self.dynamic_slot_idle_phase_minislots

    @property
    def latest_start_minislot(self) -> int:
        """Last minislot in which the longest dynamic frame may begin; 0 where none may."""
        longest = self.dynamic_slot_most_minislots(self.dynamic_payload_bytes)
        return max(0, self.minislots - longest + 1)

    def _slow_us(self, bits: int) -> float:
        """Duration of bits by the slowest clock, and their way to the farthest node."""
        return bits * self.bit_us * (1 + CLOCK_DEVIATION) + (self.propagation_delay_us or 0.0)

    def _slow_macroticks(self, bits: int) -> int:
        fast_us = self.macrotick_us * (1 - CLOCK_DEVIATION)
        return _ceiling(self._slow_us(bits) / fast_us)


def _ceiling(value: float) -> int:
    """Ceiling that forgives the rounding of a quotient that is a whole number."""
    return math.ceil(value - 1e-9)
