"""Networks of the rule `labelled` for tests: small linear plants, and an independent search."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from concord.bus.flexray.publication import Slot
from concord.bus.flexray.share_frames import read_frame
from concord.bus.fragments import read_body
from concord.bus.schedule import Schedule, full_publish
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured, decode, from_wire
from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.labelled.flooding import LabelledContent, LabelledFlooding
from concord.nodes.rules.labelled.frame import LabelledFrameCodec
from concord.nodes.rules.labelled.record_choice import RecordChoice
from concord.nodes.rules.labelled.record_codec import RecordCodec
from concord.nodes.rules.labelled.window_filter import WindowFilter
from concord.nodes.rules.local_filter import SensorGroup
from concord.nodes.vector_codec import BeliefCodec
from concord.runtime.in_process import Link
from tests.nodes import record_search
from tests.nodes.networks import Adjacency, Network, Outcome, WholeState, network, path, with_slots
from tests.nodes.record_search import Held
from tests.nodes.rule_networks import F, Q, noise_cov

PRIOR = Gaussian(np.array([1.0, -1.0]), np.diag([4.0, 2.0]))


def labelled(
    adjacency: Adjacency,
    *,
    steps: int,
    rounds: int,
    seeing: Sequence[int],
    schedule: Schedule,
    window_steps: int = 8,
    digest_steps: int = 0,
    gates: dict[int, float] | None = None,
    matrix: np.ndarray = F,
    process_noise_cov: np.ndarray = Q,
    limit_bytes: int = 246,
    repeat_above: float = 0.0,
    seed: int = 0,
) -> Network:
    """Nodes on this graph (N, N) that pass records of float64 on; each sees something else well.

    They repeat whatever is not confirmed, if `repeat_above` does not say more.
    """
    count = len(adjacency)
    net = network(
        adjacency,
        [PRIOR] * count,
        steps=steps,
        rounds=rounds,
        matrix=matrix,
        process_noise_cov=process_noise_cov,
        schedule=schedule,
        seeing=seeing,
        seed=seed,
    )
    gates = gates or {}
    sensors = [
        WholeState(noise_cov(node), gates.get(node)) if node in seeing else None
        for node in range(count)
    ]
    codecs = [None if sensor is None else RecordCodec(1, 2, "<f8", None) for sensor in sensors]
    frames = LabelledFrameCodec(
        codecs, BeliefCodec(2, "<f4"), window_steps, digest_steps, limit_bytes
    )
    neighbours = [node.neighbours for node in net.nodes]
    own = [() if one is None else (SensorGroup(slice(None), one),) for one in sensors]
    groups = tuple(
        SensorGroup(slice(i, i + 1), one) for i, one in enumerate(sensors) if one is not None
    )
    everybody = AllSensors(groups, count, (1, 2))
    nodes = []
    for config in net.nodes:
        plain: Any = config.estimator
        estimator = LabelledFlooding(
            node=config.index,
            neighbours=neighbours,
            prior=PRIOR,
            own=own[config.index],
            filter=WindowFilter(plain.model, plain.filter, everybody, codecs),
            frames=frames,
            choice=RecordChoice(
                count, window_steps, digest_steps, repeat_above, repeat_bytes=limit_bytes
            ),
            schedule=schedule,
            rounds=rounds,
        )
        nodes.append(with_slots(replace(config, estimator=estimator), _slots))
    return Network(replace(net.environment, bus=nodes[0].bus), nodes)


_FRAMES = 16


def _slots(node: int, cycle: int) -> tuple[tuple[Slot, ...], ...]:
    first = _FRAMES * node + 1
    return (tuple(Slot(first + part, 254, fixed=False) for part in range(_FRAMES)),)


# --- what should be held, found without the rule -------------------------------------------------


def taken(outcome: Outcome) -> dict[tuple[int, int], np.ndarray]:
    """Return every reading (d,) by (step, source), from the environment's messages."""
    found = {}
    for topic, data in outcome.messages:
        if topic.startswith("measured/"):
            message: Measured = decode(topic, data)
            reading = from_wire(message.readings)[0]
            if not np.isnan(reading).any():
                found[message.step, message.node] = reading
    return found


def reachable(
    net: Network, outcome: Outcome, arrives: Callable[[int, int, int], bool]
) -> list[Held]:
    """Return the records that each node can hold after each step if senders send all they hold.

    `arrives(sender, receiver, cycle)` says whether a share came through.
    """
    first = net.nodes[0]
    window_steps = first.estimator.frames.window_steps  # type: ignore[attr-defined]
    found = record_search.reachable(
        first.schedule,
        [node.neighbours for node in net.nodes],
        first.rounds,
        window_steps,
        taken(outcome).keys(),
        record_search.winners_of(outcome.messages),
        arrives,
    )
    return list(islice(found, first.steps))


def carried(net: Network, outcome: Outcome, arrives: Callable[[int, int, int], bool]) -> list[Held]:
    """Return the records of each node after each step if it keeps those of all arrived frames."""
    rounds, steps = net.nodes[0].rounds, net.nodes[0].steps
    frames: LabelledFrameCodec = net.nodes[0].estimator.frames  # type: ignore[attr-defined]
    readings = taken(outcome)
    held: Held = [{(t, j) for t, j in readings if j == i} for i in range(len(net.nodes))]
    came: dict[tuple[int, int, int], int] = {}
    for (cycle, sender), body in _shares(outcome).items():
        step = cycle // rounds
        for source, age, _ in frames.decode(body).records:
            for config in net.nodes:
                if sender in config.neighbours and arrives(sender, config.index, cycle):
                    key = (config.index, step - age, source)
                    came[key] = min(came.get(key, step), step)
    history = []
    for step in range(steps):
        now: Held = []
        for i in range(len(held)):
            own = {(t, j) for t, j in held[i] if t <= step}
            heard = {(t, j) for (node, t, j), at in came.items() if node == i and at <= step}
            now.append({label for label in own | heard if label[0] > step - frames.window_steps})
        history.append(now)
    return history


def _shares(outcome: Outcome) -> dict[tuple[int, int], bytes]:
    """Every share by cycle and sender."""
    parts: dict[tuple[int, int], list[bytes]] = {}
    for topic, data in outcome.messages:
        if topic.startswith("share/"):
            fragment = read_frame(data)
            parts.setdefault((fragment.cycle, int(topic[6:])), []).append(fragment.data)
    return {key: read_body(data) for key, data in parts.items()}


def held_by(states: Iterable[Any]) -> Held:
    """Return the records that the nodes hold at the end of a run."""
    found: Held = []
    for state in states:
        content: LabelledContent = state.content
        first = content.windows.step_at(0)
        found.append(
            {(first + place, j) for place, some in enumerate(content.kept.records) for j in some}
        )
    return found


def kalman(net: Network, readings: dict[tuple[int, int], np.ndarray], labels: Iterable) -> Gaussian:
    """The belief at the last step given these readings: a plain Kalman filter, in matrices."""
    plant = net.environment.plant
    matrix, noise = plant.matrix, plant.noise_cov  # type: ignore[attr-defined]
    mean, cov = PRIOR
    used = set(labels)
    for step in range(net.environment.steps):
        if step:
            mean, cov = matrix @ mean, matrix @ cov @ matrix.T + noise
        information, vector = np.linalg.inv(cov), np.linalg.inv(cov) @ mean
        for source in sorted(j for t, j in used if t == step):
            weight = np.linalg.inv(noise_cov(source))
            information = information + weight
            vector = vector + weight @ readings[step, source]
        cov = np.linalg.inv(information)
        mean = cov @ vector
    return Gaussian(mean, cov)


def fate(seed: int, probability: float) -> tuple[Link, Callable[[int, int, int], bool]]:
    """A link that loses frames, and the same as a predicate (sender, receiver, cycle)."""

    def arrives(sender: int, receiver: int, cycle: int) -> bool:
        draw = np.random.default_rng([seed, sender, receiver, cycle]).random()
        return bool(draw >= probability)

    def link(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        return (frame,) if arrives(sender, receiver, read_frame(frame).cycle) else ()

    return link, arrives


def lone(seeing: list[int], **options: Any) -> LabelledFlooding:
    """Node 1 of the path 0 - 1 - 2."""
    net = labelled(path(3), steps=9, rounds=1, seeing=seeing, schedule=full_publish(3), **options)
    estimator = net.nodes[1].estimator
    assert isinstance(estimator, LabelledFlooding)
    return estimator
