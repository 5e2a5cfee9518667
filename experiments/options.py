"""What a user may say of a scenario on the command line, and the scenario that it means."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import msgspec

from scenarios.catalogue import check_own, kind_of
from scenarios.scenario import Scenario
from scenarios.script import with_files


@dataclass(frozen=True, kw_only=True)
class ScenarioOptions:
    """Options left out take the scenario's own defaults (`concord list` shows them)."""

    scenario: str = "target-tracking"
    """Which scenario; `concord list` names them."""
    nodes: int | None = None
    """Number of sensor nodes."""
    graph: str | None = None
    """Who hears whom: ring, path, star, grid, complete, 4-regular, geometric, file:PATH, ..."""
    weights: str | None = None
    """Consensus weights: metropolis, maximum-degree, best-constant."""
    rule: str | None = None
    """Fusion rule."""
    rounds: int | None = None
    """Consensus iterations per step, one communication cycle each."""
    steps: int | None = None
    """Sampling instants to simulate."""
    seed: int | None = None
    """Seed of everything random."""
    run: int | None = None
    """Number of the run in a Monte Carlo under one seed."""
    schedule: str | None = None
    """Who may publish in a cycle."""
    occupancy: float | None = None
    """Share of the nodes that publish in a cycle, in (0, 1]."""
    cluster: str | None = None
    """FlexRay cluster: fitted, fitted-ab (on both channels), a preset (audi, bosch, ...), a TOML or
    FIBEX file, or none."""
    arbiter: str | None = None
    """Who wins the dynamic segment: wtod, minislot, round-robin."""
    static_slots: int | None = None
    """Sensors with a static slot of their own on a measurement bus (meng2025)."""
    trigger: float | None = None
    """Ask for a dynamic slot only after a change larger than this (squared, in covariances)."""
    stretch: float | None = None
    """Stretch the plant's sampling time by this factor to hold the bus cycles."""
    hold: str | None = None
    """What becomes of a silent neighbour's last share."""
    decay: float | None = None
    """Weight factor of a held share per cycle of age, in [0, 1]."""
    determinant_weights: bool | None = None
    """Weigh beliefs by the size of their covariance too."""
    liars: int | None = None
    """How many of a node's neighbours may say anything at all (rule trimmed-ci)."""
    number: str | None = None
    """float64 or float32 on the wire."""
    relay: bool | None = None
    """Compose each share at its slot, with what earlier slots of the cycle brought (labelled)."""
    latch_delay_us: float | None = None
    """What a host needs for --relay True, from the last bit of a frame to the first of its own."""
    window_steps: int | None = None
    """How many steps late a record may come (labelled); the schedule's latency when left out."""
    digest_steps: int | None = None
    """Say in each share what is held of so many steps, so that what links lose is sent again
    (labelled); 8 where links lose frames, when left out."""
    gate_probability: float | None = None
    """Do not pass on own readings that are less likely than this (labelled); 0 passes all on."""
    record_number: str | None = None
    """int16, float32 or float64 for readings on the wire (labelled)."""
    payload_bytes: int | None = None
    """Longest payload of a frame, 254 at most (labelled)."""
    links: str | None = None
    """What becomes of links: static, measured (by the graph's own chances), bernoulli:0.1,
    markov:0.05,0.3, switching:ring,star:10, moving:300."""
    loss: float | None = None
    """Probability that a link loses a frame on its way to one receiver, at least 0 and below 1."""
    changes: tuple[str, ...] | None = None
    """What becomes of the network, each with its step: "10 kill 3" "20 restart 3" "25 cut 1 2"
    "30 heal 1 2" "40 loss 0.2" "50 corrupt 0.05" "60 set rule=hcmci rounds=2" (docs/faults.md has
    all words); file:PATH reads them from a file, one in each line."""
    control: str | None = None
    """Whose knowledge closes the loop of a controlled plant: a node's number, truth, or open."""
    noise: str | None = None
    """What the sensors really do: matched (as the filters believe), paper (as printed), or for
    vehicle-network also growing, small, outliers, biased."""
    car: str | None = None
    """Which car is simulated (vehicle-network): bmw-320i, bmw-320i-soft, ford-escort or
    vw-vanagon."""
    manoeuvre: str | None = None
    """What the driver does (vehicle-network): double-lane-change, serpentine, ramp-steer, ..."""
    adaptive: bool | None = None
    """Let nodes learn the noise of their own sensors (vehicle-network)."""
    target: int | None = None
    """The robot to be tracked (mrclam)."""
    data: Path | None = None
    """Folder of recorded data (mrclam, vehicle-network)."""

    def resolve(self) -> Scenario:
        """The scenario that these options mean, nothing left open.

        Raises:
            ValueError: there is no such scenario, or its data cannot be read.
        """
        asked: dict[str, Any] = {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name != "scenario" and getattr(self, f.name) is not None
        }
        if "data" in asked:
            asked["data"] = str(self.data)
        return scenario_of(self.scenario, asked)


def scenario_of(name: str, asked: dict[str, Any]) -> Scenario:
    """The scenario of that name with the fields that were asked for, nothing left open.

    Raises:
        ValueError: there is no such scenario, it has no such field, or its data cannot be read.
    """
    kind = kind_of(name)
    check_own(name, asked)
    # A part of the bus is a wish for a schedule that can give it.
    if asked.get("occupancy", 1.0) < 1.0 and "schedule" not in asked:
        asked = {**asked, "schedule": "hybrid"}
    if "changes" in asked:
        asked = {**asked, "changes": with_files(asked["changes"])}
    scenario = msgspec.structs.replace(kind.defaults, **asked)
    if kind.all_steps is not None and "steps" not in asked:
        scenario = msgspec.structs.replace(scenario, steps=kind.all_steps(scenario))
    return scenario
