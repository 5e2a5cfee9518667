"""A scenario: everything that decides the numbers of a run, as one frozen value."""

import math

import msgspec

from topology.names import unknown_name


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is simulated. Equal scenarios give equal numbers in every driver.

    Attributes:
        name: which plant, sensors and models (`concord list`).
        nodes: how many sensor nodes.
        graph: who hears whom, e.g. ring, geometric, 4-regular, file:edges.txt.
        weights: consensus weights on that graph, e.g. metropolis.
        rule: how beliefs are fused, e.g. ci, wac.
        rounds: consensus iterations per step, one communication cycle each.
        steps: sampling instants of the plant.
        seed: of everything random; `run` numbers the runs of a Monte Carlo under one seed.
        schedule: who may publish in a cycle, e.g. full, round-robin.
        occupancy: share of the nodes that publish in a cycle, in (0, 1].
        cluster: the FlexRay cluster: fitted (the shortest cycle that holds the schedule), fitted-ab
            (on both channels), a preset, a TOML or FIBEX file, or none (slots without time).
        arbiter: who wins the dynamic segment: wtod, minislot, round-robin.
        static_slots: sensors 1 to that on a measurement bus own a slot each, the others contend for
            one (meng2025).
        trigger: contenders ask only if their estimate has changed by more than this since they last
            published, as a squared distance in units of their covariance; 0 asks always.
        stretch: factor by which the plant's sampling time is stretched to hold the bus cycles.
        hold: what becomes of the last share of a silent neighbour, e.g. decayed.
        decay: weight factor of a held share per cycle of age, in [0, 1].
        determinant_weights: weigh beliefs by the size of their covariance too.
        liars: rule trimmed-ci: so many of a node's neighbours may say anything at all.
        number: float64 or float32 on the wire.
        relay: a node composes its share at its own slot, with what earlier slots of the cycle
            brought; `latch_delay_us` is what its host needs for that, from the last bit of a frame.
        window_steps: rule labelled: how late a record may come; None takes the schedule's latency.
        digest_steps: rule labelled: steps of which a share says what its sender holds, so that what
            a lossy bus lost is sent again; None takes 8 where links lose frames, else 0.
        gate_probability: rule labelled: a node does not pass on a reading of its own that is less
            likely than this, and nobody uses it; 0 passes all on.
        record_number: rule labelled: int16, float32 or float64 for readings on the wire.
        payload_bytes: rule labelled: the longest payload of a frame.
        links: what becomes of them: static, measured, bernoulli:P, markov:F,R, switching:A,B:STEPS,
            moving:RANGE (`topology/link_names.py`).
        loss: probability that a link loses a frame on its way to one receiver, in [0, 1).
        changes: what becomes of the network in the run, each with the step from which it holds, in
            the words of `nodes/commands.py`: "10 kill 3", "20 cut 1 2", "30 set rule=hcmci".
        control: whose knowledge closes the loop of a plant: a node's number, truth, or open.
        noise: what the sensors really do, for plants that have a choice: matched, paper, ...
        car: which car is simulated (vehicle-network).
        manoeuvre: what the driver does (vehicle-network).
        adaptive: nodes learn the noise of their own sensors (vehicle-network).
        target: the robot that is tracked (mrclam).
        data: folder of recorded data (mrclam, vehicle-network).
    """

    name: str
    nodes: int
    graph: str
    weights: str = "metropolis"
    rule: str = "ci"
    rounds: int = 3
    steps: int
    seed: int = 1
    run: int = 0
    schedule: str = "full"
    occupancy: float = 1.0
    cluster: str = "fitted"
    arbiter: str = "wtod"
    static_slots: int = 4
    trigger: float = 0.0
    stretch: float = 1.0
    hold: str = "decayed"
    decay: float = 0.5
    determinant_weights: bool = True
    liars: int = 1
    number: str = "float64"
    relay: bool = False
    latch_delay_us: float = 5.0
    window_steps: int | None = None
    digest_steps: int | None = None
    gate_probability: float = 0.0
    record_number: str = "int16"
    payload_bytes: int = 254
    links: str = "static"
    loss: float = 0.0
    changes: tuple[str, ...] = ()
    control: str = "open"
    noise: str = "matched"
    car: str = "bmw-320i"
    manoeuvre: str = "double-lane-change"
    adaptive: bool = False
    target: int | None = None
    data: str | None = None


def check_ranges(scenario: Scenario) -> None:
    """Refuse values that no scenario can have.

    Raises:
        ValueError: naming the field, its value, the rule and the cure.
    """
    require(scenario.nodes >= 1, "nodes", scenario.nodes, "at least 1")
    require(scenario.steps >= 1, "steps", scenario.steps, "at least 1")
    require(scenario.rounds >= 1, "rounds", scenario.rounds, "at least 1")
    require(scenario.seed >= 0, "seed", scenario.seed, "0 or more")
    require(scenario.run >= 0, "run", scenario.run, "0 or more")
    require(0 < scenario.occupancy <= 1, "occupancy", scenario.occupancy, "in (0, 1]")
    require(scenario.trigger >= 0, "trigger", scenario.trigger, "0 or more")
    require(1 <= scenario.stretch < math.inf, "stretch", scenario.stretch, "at least 1, and finite")
    require(0 <= scenario.decay <= 1, "decay", scenario.decay, "in [0, 1]")
    require(0 <= scenario.loss < 1, "loss", scenario.loss, "at least 0 and below 1")
    require(scenario.liars >= 0, "liars", scenario.liars, "0 or more")
    latch_us = scenario.latch_delay_us
    require(0 <= latch_us < math.inf, "latch-delay-us", latch_us, "0 or more, and finite")
    digest = scenario.digest_steps
    require(digest is None or digest >= 0, "digest-steps", digest, "0 or more")
    gate = scenario.gate_probability
    require(0 <= gate < 1, "gate-probability", gate, "at least 0 and below 1")
    payload = scenario.payload_bytes
    require(payload % 2 == 0 and 16 <= payload <= 254, "payload-bytes", payload, "even, 16 to 254")
    if scenario.number not in ("float64", "float32"):
        raise unknown_name("number", scenario.number, ("float64", "float32"))


def lossy_links(scenario: Scenario) -> str:
    """Why links do not bring every frame, in the words of the options; "" if they do."""
    if scenario.loss > 0:
        return f"--loss {scenario.loss:g}"
    return "" if scenario.links == "static" else f"--links {scenario.links}"


def require(holds: bool, field: str, value: object, rule: str) -> None:
    """Raise a ValueError that names the option, its value and the rule unless it `holds`."""
    if not holds:
        raise ValueError(f"--{field.replace('_', '-')} {value}: must be {rule}")
