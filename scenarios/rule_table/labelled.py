"""The rule `labelled` in a scenario: the knowledge common to all nodes, and the refused cases."""

from collections.abc import Sequence
from functools import partial
from math import ceil
from typing import NamedTuple, cast

import numpy as np

from concord.bus.schedule import publishers_per_cycle
from concord.nodes.commands import Restart
from concord.nodes.rules.labelled.frame import (
    MAX_SOURCES,
    MAX_WINDOW_STEPS,
    LabelledFrameCodec,
    check_limit,
    labelled_bytes,
    least_limit,
)
from concord.nodes.rules.labelled.record_choice import RecordChoice
from concord.nodes.rules.labelled.record_codec import (
    PACKED,
    Calibrated,
    reading_bytes,
    record_codec,
)
from concord.nodes.vector_codec import BeliefCodec
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.catalogue import definition_of
from concord.scenarios.filter_table.filters import learns
from concord.scenarios.node_context import Everybody
from concord.scenarios.rule_table.rule import BELIEFS
from concord.scenarios.scenario import Scenario, lossy_links
from concord.scenarios.script import script_of
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.rules import LEAST_WINDOW_STEPS, FloodingRule, MeasurementFlooding
from concord.scenarios.types.schedules import DynamicSchedule, occupancy_of, trigger_of

RECORD_NUMBERS = {"int12": PACKED, "int16": "<i2", "float32": "<f4", "float64": "<f8"}
# Nodes learn of a loss from the next shares of their neighbours. Longer digests gain little.
_DIGEST_TURNS, _LEAST_DIGEST_STEPS, _MOST_DIGEST_STEPS = 2, 3, 10
# A digest and the mask of records take as many bits each, and leave a frame room for records.
_MOST_DIGEST_BITS = 600
_NEGLIGIBLE_LOSS = 0.01
# Range and bearing are two numbers. The record of most sensors takes fewer bytes than the content.
_USUAL_NUMBERS = 2
_LEAST_CONTENT_BYTES = 96
# The longest of FlexRay. Longer frames of other buses would lengthen their cycles unasked, and
# shorter ones hold no share.
_USUAL_PAYLOAD_BYTES = 254


def flooding_of(scenario: Scenario) -> MeasurementFlooding:
    """The rule of a scenario that floods measurements; one of another class has its options as
    constants."""
    assert isinstance(scenario.rule, FloodingRule), "the table of rules chose it"
    return cast(MeasurementFlooding, scenario.rule)


def frame_codec(
    everybody: Everybody, neighbours: Sequence[Sequence[int]], states: int
) -> LabelledFrameCodec:
    """How the shares of this network are written.

    Raises:
        ValueError: a share cannot hold what it must.
    """
    scenario = everybody.scenario
    number, origin = RECORD_NUMBERS[flooding_of(scenario).record_number], everybody.origin
    return LabelledFrameCodec(
        [
            record_codec(sensor, everybody.readings_shape, number, origin)
            for sensor in everybody.sensors
        ],
        checkpoint_codec(scenario, states, origin),
        window_of(scenario, neighbours),
        digest_of(scenario),
        *share_limits(scenario, states),
    )


def checkpoint_codec(
    scenario: Scenario, states: int, origin: np.ndarray | None = None
) -> BeliefCodec:
    """How the beliefs are written that begin a window."""
    number = flooding_of(scenario).checkpoint_number
    codec = BELIEFS.codec(number, states, scenario.nodes, origin=origin)
    return BeliefCodec(states, number, codec.form)


def choice_of(scenario: Scenario, frames: LabelledFrameCodec) -> RecordChoice:
    """How nodes choose the records of these shares."""
    rule = flooding_of(scenario)
    return RecordChoice(
        len(frames.codecs),
        frames.window_steps,
        frames.digest_steps,
        rule.repeat_above,
        rule.repeat_bytes,
    )


class ShareLimits(NamedTuple):
    """Most bytes of a share, and of one with a checkpoint."""

    usual: int
    longest: int


def largest_share(scenario: Scenario, states: int) -> int:
    """Length in bytes of the longest share.

    Raises:
        ValueError: as `share_limits`.
    """
    return share_limits(scenario, states).longest


def share_limits(scenario: Scenario, states: int) -> ShareLimits:
    """Return the limits of shares: what one frame holds beside its numbers.

    A record or a checkpoint that no frame holds makes shares of several frames. Where nodes own
    static slots, all shares have one length; elsewhere those with a checkpoint alone are longer.

    Raises:
        ValueError: frames as short as asked for hold no checkpoint of so many states, and longer
            ones would.
    """
    form, asked = frame_format(scenario), flooding_of(scenario).payload_bytes
    checkpoint, record = checkpoint_codec(scenario, states).size, _longest_record(scenario)
    least = partial(least_limit, scenario.nodes, digest_of(scenario))
    most = (_USUAL_PAYLOAD_BYTES if asked is None else asked) - form.numbering_bytes
    if least(max(checkpoint, record)) <= _USUAL_PAYLOAD_BYTES - form.numbering_bytes:
        check_limit(most, scenario.nodes, digest_of(scenario), max(checkpoint, record))
    if asked is None and not isinstance(scenario.bus.schedule, DynamicSchedule):
        content = max(checkpoint, record, _expected_need(scenario), _LEAST_CONTENT_BYTES)
        limit = max(min(most, least(content)), least(max(checkpoint, record)))
        return ShareLimits(limit, limit)
    usual, in_frame = max(most, least(record)), form.payload_limit_bytes - form.numbering_bytes
    frames = ceil(least(checkpoint) / in_frame)
    return ShareLimits(usual, usual if least(checkpoint) <= usual else frames * in_frame)


def _longest_record(scenario: Scenario) -> int:
    """Bytes of the longest record of one reading, with its label, of sensors that say their noise.

    Others, and several readings in a step, must do with the share that there is.
    """
    definition, number = definition_of(scenario), flooding_of(scenario).record_number
    sizes = [0]
    for sensor in {definition.sensor(scenario, node) for node in range(scenario.nodes)}:
        if isinstance(sensor, Calibrated):
            codec = record_codec(sensor, (1, np.size(sensor.noise_std)), RECORD_NUMBERS[number])
            sizes.append(0 if codec is None else codec.size_max)
    return labelled_bytes(max(sizes))


def _expected_need(scenario: Scenario) -> int:
    """Bytes of the records that a share takes, if half of the nodes send each record of a step.

    Records that find no room wait; a contender bids for them.
    """
    number = RECORD_NUMBERS[flooding_of(scenario).record_number]
    record_bytes = labelled_bytes(reading_bytes(_USUAL_NUMBERS, number))
    shares = scenario.rounds * occupancy_of(scenario.bus.schedule)
    return ceil(record_bytes * scenario.nodes / 2 / shares)


def window_of(scenario: Scenario, neighbours: Sequence[Sequence[int]]) -> int:
    """Steps in the window: what was asked for, else the latency, but 32 at least."""
    asked = flooding_of(scenario).window_steps
    if asked is not None:
        return asked
    latency = latency_steps(scenario, neighbours)
    return min(max(latency, LEAST_WINDOW_STEPS), MAX_WINDOW_STEPS)


def digest_of(scenario: Scenario) -> int:
    """Steps in a digest: what was asked for, else those of two turns where links lose frames.

    A turn is the mean time between two shares of a node.
    """
    rule, network = flooding_of(scenario), scenario.network
    if rule.digest_steps is not None:
        return rule.digest_steps
    if network.links == "static" and network.loss <= _NEGLIGIBLE_LOSS:
        return 0
    steps = _DIGEST_TURNS * scenario.nodes // _shares_per_step(scenario)
    steps = min(max(steps, _LEAST_DIGEST_STEPS), _MOST_DIGEST_STEPS)
    return min(steps, max(_MOST_DIGEST_BITS // scenario.nodes, 1), rule.window_steps or steps)


def without_arrays(scenario: Scenario) -> str | None:
    """Return the part of a scenario that has no array form under this rule; None if all has."""
    # Elsewhere a share may take several frames, of which a link loses each by itself.
    bus, lossy = scenario.bus, lossy_links(scenario) or bool(scenario.changes) * "--changes"
    form = frame_format(scenario)
    if lossy and _longest_payload(scenario) > form.payload_limit_bytes:
        limit = form.payload_limit_bytes
        return f"rule labelled on --bus {bus.name} with frames of {limit} bytes and {lossy}"
    if lossy and isinstance(bus, FlexRay) and bus.cluster not in ("fitted", "fitted-ab"):
        return f"rule labelled on --cluster {bus.cluster} with {lossy}"
    if any(isinstance(one.command, Restart) for one in script_of(scenario)):
        # Windows of one network would begin at different steps.
        return "rule labelled where nodes come back (--changes restart)"
    return None


def _longest_payload(scenario: Scenario) -> int:
    """Bytes of a frame that would hold the longest share."""
    usual = flooding_of(scenario).payload_bytes or _USUAL_PAYLOAD_BYTES
    definition = definition_of(scenario)
    if definition.wirings:
        return usual
    states = len(definition.plant(scenario).state_names)
    longest = largest_share(scenario, states) + frame_format(scenario).numbering_bytes
    return max(usual, longest)


def gates_of(scenario: Scenario, channels: int) -> tuple[float, ...]:
    """Chi-square thresholds for readings of 1, 2, ... `channels` entries; none for no gate."""
    probability = flooding_of(scenario).gate_probability
    if probability == 0:
        return ()
    # Only here: a node without a gate need not wait for it.
    from scipy.special import chdtri

    return tuple(chdtri(np.arange(1, channels + 1), probability).tolist())


def latency_steps(scenario: Scenario, neighbours: Sequence[Sequence[int]]) -> int:
    """Steps in which a record crosses the graph if every node must wait for a turn of all others:
    diameter times nodes over shares per step."""
    return -(-_diameter(neighbours) * scenario.nodes // _shares_per_step(scenario))


def _shares_per_step(scenario: Scenario) -> int:
    return scenario.rounds * publishers_per_cycle(
        scenario.nodes, occupancy_of(scenario.bus.schedule)
    )


def check_labelled(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], _weights: object
) -> None:
    """Refuse what the rule cannot do.

    Raises:
        ValueError: naming the option, its value, the rule and the cure.
    """
    if scenario.nodes > MAX_SOURCES:
        raise ValueError(
            f"rule labelled with --nodes {scenario.nodes}: a label names its source in one byte, "
            f"for {MAX_SOURCES} nodes at most; use rule ci or hcmci"
        )
    if learns(scenario.filter):
        raise ValueError(
            f"rule labelled with --filter {scenario.filter.name}: it sends readings, whose noise "
            "every node takes from the data sheet; use --filter ukf with it, or rule ci"
        )
    rule = flooding_of(scenario)
    window = rule.window_steps
    if window is not None and not 1 <= window <= MAX_WINDOW_STEPS:
        raise ValueError(
            f"--window-steps {window}: must be 1 to {MAX_WINDOW_STEPS}, as a label says the age of "
            "a record in one byte; leave it out for the latency of the schedule"
        )
    if digest_of(scenario) > window_of(scenario, neighbours):
        raise ValueError(
            f"--digest-steps {rule.digest_steps}: nothing older than the window of "
            f"{window_of(scenario, neighbours)} steps is held; lower it, or raise --window-steps"
        )
    if rule.smooth_steps >= window_of(scenario, neighbours):
        raise ValueError(
            f"--smooth-steps {rule.smooth_steps}: must be below {window_of(scenario, neighbours)}, "
            "as a node can only estimate again the steps of its window; lower it, or raise "
            "--window-steps"
        )
    if (trigger := trigger_of(scenario.bus.schedule)) > 0:
        raise ValueError(
            f"--trigger {trigger:g}: rule labelled asks for a slot when a neighbour lacks "
            "a record, and not when its estimate has changed; use --withhold-below instead"
        )
    for node, heard in enumerate(neighbours):
        for other in heard:
            if node not in neighbours[other]:
                raise ValueError(
                    f"rule labelled on graph {scenario.network.graph}: node {node} hears node "
                    f"{other}, which does not hear it; a node must hear those it passes records "
                    "to: use an undirected graph, or rule ci"
                )


def _diameter(neighbours: Sequence[Sequence[int]]) -> int:
    """Most hops between two nodes of a connected graph."""
    nodes = len(neighbours)
    reach = np.eye(nodes, dtype=bool)
    hears = reach.copy()
    for node, heard in enumerate(neighbours):
        hears[node, list(heard)] = True
    hops = 0
    while not reach.all() and hops < nodes:
        reach = hears @ reach
        hops += 1
    return hops
