"""Several targets that appear, turn and disappear on a square."""

import math
from dataclasses import dataclass

import numpy as np

from concord.plants.motion import CoordinatedTurn, require_positive
from concord.plants.placement import GeneratorFor

MANOEUVRE_EVERY_STEPS = 20
FASTEST_TURN_RAD_S = 0.1
TURNS_BACK_AT = 0.35
"""Distance from the middle beyond which a target turns back, in sides of the square."""


@dataclass(frozen=True)
class Swarm:
    """K targets on a square of `side_m`, each with a stream of random numbers of its own.

    Half of the targets are there from the first step, the others appear within the first half of
    the run. A target stays for at least a third of the run. It moves with constant speed on arcs:
    every 20 steps on average it draws a new rate of turn, half of which are 0 and the others
    uniform within 0.1 rad/s. Near the edge of the square it turns back at 0.1 rad/s.

    Raises:
        ValueError: for no targets, or lengths that are not positive.
    """

    targets: int
    side_m: float = 1000.0
    slowest_m_s: float = 5.0
    fastest_m_s: float = 15.0
    time_step_s: float = 1.0

    def __post_init__(self) -> None:
        if self.targets < 1:
            raise ValueError(f"targets {self.targets}: must be 1 or more")
        require_positive(side_m=self.side_m, time_step_s=self.time_step_s)

    def truth(self, generator_for: GeneratorFor, steps: int) -> np.ndarray:
        """States [x, vx, y, vy] (steps, K, 4) in m and m/s; NaN where a target is not there."""
        paths = [
            self._path(generator_for("target", target), target, steps)
            for target in range(self.targets)
        ]
        return np.stack(paths, axis=1)

    def _path(self, generator: np.random.Generator, target: int, steps: int) -> np.ndarray:
        turn = CoordinatedTurn(self.time_step_s)
        place = self.side_m * generator.uniform(0.1, 0.9, 2)
        heading = generator.uniform(-math.pi, math.pi)
        speed = generator.uniform(self.slowest_m_s, self.fastest_m_s)
        appears = generator.integers(0, max(steps // 2, 1)) if target % 2 else 0
        stays = generator.integers(max(steps // 3, 1), steps + 1)
        changes = generator.random(steps) < 1 / MANOEUVRE_EVERY_STEPS
        rates = generator.uniform(-FASTEST_TURN_RAD_S, FASTEST_TURN_RAD_S, steps)
        rates = np.where(generator.random(steps) < 0.5, 0.0, rates)
        path = np.full((steps, 4), np.nan)
        velocity = speed * math.cos(heading), speed * math.sin(heading)
        state = np.array([place[0], velocity[0], place[1], velocity[1], 0.0])
        for step in range(appears, min(appears + stays, steps)):
            path[step] = state[:4]
            if changes[step]:
                state[4] = rates[step]
            state[4] = self._kept_inside(state)
            state = turn.transition(state, None, step)
        return path

    def _kept_inside(self, state: np.ndarray) -> float:
        """Return the rate of turn of a state (5,), that of a turn back near the edge."""
        x, vx, y, vy, rate = state
        inward_x, inward_y = self.side_m / 2 - x, self.side_m / 2 - y
        is_inside = math.hypot(inward_x, inward_y) <= TURNS_BACK_AT * self.side_m
        if is_inside or vx * inward_x + vy * inward_y > 0:
            return rate
        return math.copysign(FASTEST_TURN_RAD_S, vx * inward_y - vy * inward_x)
