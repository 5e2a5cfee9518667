"""`concord flexray design-turns`: turns of nodes that make the error bound of a network least."""

import sys
from collections.abc import Sequence
from math import sqrt
from pathlib import Path
from typing import Annotated, cast

import msgspec
import numpy as np
import tyro

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.share_frames import payload_lengths
from concord.bus.flexray.slot_file import checked_slots, slots_to_toml
from concord.experiments.scenario_flags import ScenarioFlags, resolved
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.commands.clusters import read_cluster, write_new
from concord.features.flexray_tools.commands.rehearsal import prepare_without_bus
from concord.features.flexray_tools.slot_design.turns import (
    CycleTurn,
    best_turns,
    equal_turns,
    places_of_turns,
)
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import share_bytes
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import FlexRay
from concord.studies.exact.aged_readings import aged_cov, steady_cov
from concord.studies.exact.network import linear_network


class NodeTurn(msgspec.Struct, frozen=True):
    """The turn of one node, and the age in steps that its readings reach at other nodes."""

    node: int
    frame_ids: list[int]
    base_cycle: int
    repetition: int
    oldest_steps: int


class TurnAnswer(msgspec.Struct, frozen=True):
    """Turns of a network, and bounds of its RMSE as multiples of that with all readings.

    `exact` says that no turns have a lower bound.
    """

    nodes: list[NodeTurn]
    bound: float
    bound_of_equal_turns: float
    exact: bool


def design_turns_command(
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    *,
    shares: int,
    longest: int = 8,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: bool = False,
) -> None:
    """Give each node turns in the static slots so that the error bound of the network is least.

    Args:
        shares: How many nodes may send in a cycle.
        longest: Longest turn in cycles: 1, 2, 4, ..., 64.
        out: Slot table (.toml) to write, for --slots.
        json: Print one JSON object.
    """
    with user_errors():
        asked = resolved(scenario)
        cluster_name = asked.bus.cluster if isinstance(asked.bus, FlexRay) else ""
        if not cluster_name or cluster_name.startswith("fitted"):
            wrong = f"--cluster {cluster_name}" if cluster_name else f"--bus {asked.bus.name}"
            raise ValueError(
                f"{wrong}: turns are static slots of a cluster that is known before "
                "its table; name one with --cluster audi or a file"
            )
        cluster = read_cluster(cluster_name, None)
        setup = prepare_without_bus(asked)
        answer, slots = design_turns(setup, cluster, shares, longest)
        if out is not None:
            write_new(out, slots_to_toml(slots))
    if json:
        sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
        return
    sys.stdout.writelines(f"{line}\n" for line in _lines(answer, out))


def design_turns(
    setup: Setup, cluster: Cluster, shares: int, longest: int
) -> tuple[TurnAnswer, tuple[MessageSlot, ...]]:
    """Return the turns of least error bound, and their slot table.

    The bound is the mean error, over steps and nodes, of the best estimator. It knows a node's own
    readings at once, and those of another node up to that node's last turn.

    Raises:
        ValueError: the plant is not linear, or the cluster has no room.
    """
    scenario = setup.scenario
    lengths = payload_lengths(share_bytes(setup), cluster.static_payload_bytes)
    _check(shares, longest, len(lengths), cluster)
    network = linear_network(setup)
    steady = steady_cov(network)
    scored = list(definition_of(scenario).score.states)
    least = np.diag(steady)[scored].sum()

    def bound(turns: Sequence[CycleTurn]) -> float:
        covs = aged_cov(network, steady, reading_ages(turns, scenario.rounds))
        return sqrt(np.diagonal(covs, axis1=-2, axis2=-1)[..., scored].sum(-1).mean() / least)

    found = best_turns(scenario.nodes, shares, longest, bound)
    equal = bound(equal_turns(scenario.nodes, shares, longest))
    slots = _slots(found.turns, lengths, cluster)
    oldest = reading_ages(found.turns, scenario.rounds).max(axis=(0, 1))
    rows = [
        NodeTurn(
            node,
            [slot.frame_id for slot in slots if slot.node == node],
            turn.base_cycle,
            turn.repetition,
            int(oldest[node]),
        )
        for node, turn in enumerate(found.turns)
    ]
    return TurnAnswer(rows, found.cost, equal, found.exact), slots


def reading_ages(turns: Sequence[CycleTurn], rounds: int) -> np.ndarray:
    """Return how many of the last readings of each node the others lack, (T, N, N).

    Axes: step of the period, receiver, sender. A receiver lacks none of its own.
    """
    steps = max(turn.repetition for turn in turns)
    ages = np.zeros((steps, len(turns), len(turns)), dtype=np.int64)
    for step in range(steps):
        last = (step + 1) * rounds - 1
        for node, turn in enumerate(turns):
            sent = last - (last - turn.base_cycle) % turn.repetition
            ages[step, :, node] = step - sent // rounds
    own = np.arange(len(turns))
    ages[:, own, own] = 0
    return ages


def _check(shares: int, longest: int, frames: int, cluster: Cluster) -> None:
    known = [1 << k for k in range(7) if cluster.number_of_cycles % (1 << k) == 0]
    if longest not in known:
        raise ValueError(f"--longest {longest}: use {', '.join(map(str, known))}")
    if not 1 <= shares * frames <= cluster.static_slots:
        raise ValueError(
            f"--shares {shares}: shares of {frames} frames take {shares * frames} static slots, "
            f"but cluster {cluster.name!r} has {cluster.static_slots}; use at most --shares "
            f"{cluster.static_slots // frames}"
        )


def _slots(
    turns: Sequence[CycleTurn], lengths: Sequence[int], cluster: Cluster
) -> tuple[MessageSlot, ...]:
    slots = [
        MessageSlot(
            frame_id=1 + place * len(lengths) + number,
            payload_bytes=-(-length // 2) * 2,
            node=node,
            channel=cast(Channels, cluster.channels),
            base_cycle=turn.base_cycle,
            repetition=turn.repetition,
        )
        for node, (turn, place) in enumerate(zip(turns, places_of_turns(turns), strict=True))
        for number, length in enumerate(lengths)
    ]
    return checked_slots(slots, cluster)


def _lines(answer: TurnAnswer, out: Path | None) -> list[str]:
    text = [
        f"node {one.node}: slot {', '.join(map(str, one.frame_ids))}, cycles {one.base_cycle} "
        f"modulo {one.repetition}, readings up to {one.oldest_steps} steps old"
        for one in answer.nodes
    ]
    best = "no turns have less" if answer.exact else "the best that was found"
    text.append(
        f"error bound: {answer.bound:.4f} x the error with all readings ({best}); equal turns: "
        f"{answer.bound_of_equal_turns:.4f}"
    )
    return text + ([f"the slot table is in {out}"] if out is not None else [])
