"""`target-swarm`: several targets that come and go, under sensors with misses and clutter.

The ground, the sensors and the radio are those of `target-tracking`. Detections carry no target.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from concord.filters.association.associate import ASSOCIATIONS
from concord.filters.sigma_points import cubature
from concord.filters.tracking.tracker import Scan, TrackerSettings
from concord.nodes.commands import Configure
from concord.plants.motion import ConstantVelocity
from concord.plants.placement import place_sensors
from concord.plants.range_bearing import RangeBearing
from concord.plants.scanning import FALSE_ALARM, MOST_CLUTTER, ScanningSensor
from concord.plants.swarm import Swarm
from concord.scenarios.definitions.target_tracking import RADIO_RANGE_M, TURNING
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.script import script_of, with_files
from concord.scenarios.setup import Setup
from concord.scenarios.streams import generator
from concord.topology.names import unknown_name

STATES = 4
MOST_TARGETS = 200
"""On the ground of the scenario, one to each square of 70 m."""
NEW_TARGETS = 0.1
"""Expected number of new targets in a scan, as a tracker assumes it."""
END_OVER_BIRTH = 0.1
ACCELERATION_DENSITY_M2_S3 = 1.0
"""So much the tracker allows for turns: 0.1 rad/s at 10 m/s is an acceleration of 1 m/s²."""


@dataclass(frozen=True, kw_only=True)
class TargetSwarm:
    """The simulated case. Equal values give equal numbers."""

    nodes: int = 20
    """Number of sensor nodes."""
    targets: int = 5
    """Number of targets that are there at some time."""
    detection: float = 0.9
    """Detection probability at 0.71 of the field of view; nearer targets have more."""
    clutter: float = 5.0
    """Expected number of clutter detections in a scan."""
    merge_m: float = 0.0
    """Detected targets at most so far apart, in m, give a single detection; 0 for none."""
    steps: int = 100
    """Sampling instants to simulate, one second each."""
    association: str = "jpda"
    """How detections are assigned: jpda or nearest."""
    rounds: int = 16
    """Communication cycles of a step."""
    bus: str = "flexray"
    """Bus that the nodes share: flexray, plca, can-fd or ideal."""
    occupancy: float = 1.0
    """Share of the nodes that publish in a cycle."""
    cluster: str = ""
    """FlexRay cluster, as of `concord run`; fitted when left out."""
    payload_bytes: int = 254
    """Longest share of scans."""
    loss: float = 0.0
    """Probability that a link loses a frame on its way to one receiver."""
    changes: tuple[str, ...] = ()
    """Faults, each with its step: "50 kill 3" "70 restart 3" (docs/faults.md has all words)."""
    window_steps: int = 8
    """Steps after which a scan that has not come is left out."""
    placement: int = 0
    """Which drawing of the nodes' places."""
    seed: int = 1
    """Seed of everything random."""
    run: int = 0
    """Number of the run in a Monte Carlo under one seed."""

    def check(self) -> None:
        """Refuse what no swarm can be.

        Raises:
            ValueError: naming the option, its value and the rule.
        """
        for name, least in (
            ("nodes", 1), ("targets", 1), ("steps", 1), ("rounds", 1), ("window_steps", 1),
            ("placement", 0), ("seed", 0), ("run", 0),
        ):  # fmt: skip
            value = getattr(self, name)
            require(value >= least, name, value, f"{least} or more")
        require(self.targets <= MOST_TARGETS, "targets", self.targets, f"{MOST_TARGETS} or fewer")
        require(
            FALSE_ALARM < self.detection < 1,
            "detection",
            self.detection,
            f"above {FALSE_ALARM:g}, the probability of a false alarm, and below 1; a sensor "
            "that misses nothing has no tracker to test",
        )
        require(
            0 <= self.clutter <= MOST_CLUTTER,
            "clutter",
            self.clutter,
            f"0 to {MOST_CLUTTER} detections in a scan",
        )
        require(0 <= self.merge_m < np.inf, "merge_m", self.merge_m, "0 m or more, and finite")
        if self.association not in ASSOCIATIONS:
            raise unknown_name("association", self.association, ASSOCIATIONS)
        for step, command in script_of(self.network()):
            if isinstance(command, Configure):
                raise ValueError(
                    f"--changes {step} set: tracks keep their rule and bus; leave it out, or ask "
                    "for others from the start"
                )
        # Placing the nodes is what else can fail, and says why.
        self.setup()

    def network(self) -> Scenario:
        """The nodes, their links, bus and faults: those of `target-tracking` with its flooding."""
        asked: dict[str, Any] = {
            name: getattr(self, name)
            for name in (
                "nodes", "placement", "steps", "seed", "run", "rounds", "bus", "occupancy", "loss",
                "window_steps", "payload_bytes",
            )
        }  # fmt: skip
        if self.cluster:
            asked["cluster"] = self.cluster
        # Where a part of the nodes publishes, scans of different lengths ask for the slots.
        changes = with_files(self.changes)
        return TURNING.defaults.with_(rule="labelled", changes=changes, **asked)

    def setup(self) -> Setup:
        """The network worked out.

        Raises:
            ValueError: anything that cannot run, named with its value, the rule and the cure.
        """
        return prepare(self.network())

    def positions(self) -> np.ndarray:
        """Places (nodes, 2) of the nodes in m."""
        return _positions(self.nodes, self.placement)

    def truth(self) -> np.ndarray:
        """States (steps, targets, 4) of the targets, NaN where one is not there."""
        return Swarm(self.targets).truth(self.stream, self.steps)

    def sensors(self) -> list[ScanningSensor]:
        """The sensors of all nodes."""
        return [
            ScanningSensor(RangeBearing(place), self.detection, self.clutter, merge_m=self.merge_m)
            for place in self.positions()
        ]

    def scans(self, truth: np.ndarray) -> list[list[Scan]]:
        """Return the scans of all nodes in each step."""
        sensors = self.sensors()
        streams = [self.stream("scan", node) for node in range(self.nodes)]
        return [
            [
                Scan(node, sensor, sensor.scan(states, stream))
                for node, (sensor, stream) in enumerate(zip(sensors, streams, strict=True))
            ]
            for states in truth
        ]

    def stream(self, purpose: str, node: int) -> np.random.Generator:
        """Return the random stream of one purpose at one node."""
        return generator(self, purpose, node)

    def settings(self) -> TrackerSettings:
        """Return the settings of a tracker: constant velocity, disturbed by the targets' turns."""
        birth = NEW_TARGETS / (NEW_TARGETS + self.clutter)
        motion = ConstantVelocity(acceleration_density_m2_s3=ACCELERATION_DENSITY_M2_S3)
        return TrackerSettings(
            lambda states: motion.transition(states, None, 0),
            motion.process_noise_cov(0),
            cubature(STATES),
            ASSOCIATIONS[self.association],
            birth=birth,
            # A track may lose nine tenths of its first existence, however small that is.
            end_below=END_OVER_BIRTH * birth,
        )


@cache
def _positions(nodes: int, placement: int) -> np.ndarray:
    return place_sensors(nodes, radio_range_m=RADIO_RANGE_M, drawing=placement)
