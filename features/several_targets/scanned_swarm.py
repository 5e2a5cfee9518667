"""A swarm under scanning sensors, as a plant: paths and scans are drawn before the run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from concord.features.several_targets.scanning import ScanningSensor
from concord.features.several_targets.swarm import Swarm
from concord.plants.placement import Draws, GeneratorFor

TARGET_STATES = 4
PLACES = slice(0, None, 2)
"""Of a target's states [x, vx, y, vy]."""
_SPARE_DEVIATIONS, _SPARE_ROWS = 6, 6
"""Clutter for which a scan has room, beyond its mean."""


@dataclass(frozen=True, eq=False)
class ScannedSwarm:
    """The number of targets, then the states of each [x, vx, y, vy]: NaN where one is not there.

    A node delivers its scan as rows (1 + D, 2): the number of its detections, the detections, NaN.

    Attributes:
        swarm: the targets. sensors: those of the nodes, alike but for their places.
        undetected: expected number of targets that no sensor has seen yet.
    """

    swarm: Swarm
    sensors: Sequence[ScanningSensor]
    undetected: float

    state_names = ("targets",)
    state_units = ("1",)

    @property
    def time_step_s(self) -> float:
        return self.swarm.time_step_s

    @property
    def field_of_view_m(self) -> float:
        """The range of each sensor."""
        return self.sensors[0].field_of_view_m

    @property
    def rows(self) -> int:
        """Most detections of a scan; those beyond, the last ones, are lost."""
        clutter = self.sensors[0].clutter
        spare = _SPARE_DEVIATIONS * math.sqrt(clutter) + _SPARE_ROWS
        return self.swarm.targets + math.ceil(clutter + spare)

    def positions(self, step: int) -> np.ndarray:
        """Where the nodes are: (nodes, 2) in m."""
        return np.array([one.sensor.position_m for one in self.sensors])

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the first state, the states of all later steps, and the scans."""
        paths = self.swarm.truth(generator_for, steps)
        there = np.isfinite(paths).all(axis=-1).sum(axis=1)
        states = np.column_stack((there, paths.reshape(steps, -1)))
        scans = np.full((steps, len(self.sensors), 1 + self.rows, 2), np.nan)
        for node, sensor in enumerate(self.sensors):
            stream = generator_for("scan", node)
            for rows, targets in zip(scans[:, node], paths, strict=True):
                write_scan(rows, sensor.scan(targets, stream))
        return Draws(states[0], np.roll(states, -1, axis=0), scans)

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., 1 + 4K), prior mean (..., 1) and cov (1, 1) of the number of targets."""
        mean = np.full((*noise.shape[:-1], 1), self.undetected)
        return noise, mean, np.full((1, 1), self.undetected)

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """Return the states that were drawn."""
        return noise

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the scans that were drawn."""
        return noise


def paths_of(states: np.ndarray) -> np.ndarray:
    """Return the states (..., K, 4) of the targets in those of the plant (..., 1 + 4K)."""
    return states[..., 1:].reshape(*states.shape[:-1], -1, TARGET_STATES)


def write_scan(rows: np.ndarray, detections: np.ndarray) -> None:
    """Write as many detections (D, 2) as there is room for into rows (1 + D, 2)."""
    kept = detections[: len(rows) - 1]
    rows[0, 0] = len(kept)
    rows[1 : 1 + len(kept)] = kept


def detections_of(rows: np.ndarray) -> np.ndarray | None:
    """The detections (D, 2) of a scan (1 + D, 2); None where there was none."""
    return None if np.isnan(rows[0, 0]) else rows[1 : 1 + int(rows[0, 0])]
