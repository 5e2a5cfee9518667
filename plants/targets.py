"""A target that moves in the plane under the eyes of fixed sensors with a limited field of view.

`turning_target` is the scenario TRACK of the project's consensus study; `straight_target` has the
same sensors and a state without a rate of turn.
"""

from dataclasses import dataclass

import numpy as np

from concord.plants.motion import ConstantVelocity, CoordinatedTurn, Motion, require_positive
from concord.plants.placement import Draws, GeneratorFor, standard_draws
from concord.plants.range_bearing import Moves, RangeBearing, wrapped


@dataclass(frozen=True, eq=False)
class Target:
    """A plant: one target, one range-bearing sensor per node.

    The truth starts at `start`; the common prior mean errs from it by `start_std` per state. A node
    delivers (range, bearing) while the target is within `field_of_view_m`, otherwise NaN.

    Raises:
        ValueError: for shapes that do not fit, or values that are not positive.
    """

    model: Motion
    sensors: RangeBearing  # of all nodes
    start: tuple[float, ...]
    start_std: tuple[float, ...]
    field_of_view_m: float = 350.0

    def __post_init__(self) -> None:
        states = len(self.model.state_names)
        for name, values in (("start", self.start), ("start_std", self.start_std)):
            if len(values) != states:
                raise ValueError(
                    f"{name} has {len(values)} values, but the model has {states} states "
                    f"{self.model.state_names}; give one for each"
                )
        if np.ndim(self.sensors.position_m) != 2:
            raise ValueError("sensors.position_m must be (nodes, 2): the plant has all nodes")
        require_positive(field_of_view_m=self.field_of_view_m, start_std=min(self.start_std))

    @property
    def nodes(self) -> int:
        return len(self.sensors.position_m)

    @property
    def time_step_s(self) -> float:
        return self.model.time_step_s

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.model.state_names

    @property
    def state_units(self) -> tuple[str, ...]:
        return self.model.state_units

    def sensor(self, node: int) -> RangeBearing:
        """Return the sensor of one node."""
        return self.sensors.for_node(node)

    def positions(self, step: int) -> np.ndarray:
        """Where the nodes are: (nodes, 2) in m."""
        return self.sensors.places(step)

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run."""
        states = len(self.start)
        return standard_draws(generator_for, states, states, (self.nodes, 1, 2), steps)

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., n), prior mean (..., n) and prior cov (n, n) for noise (..., n)."""
        start_std = np.asarray(self.start_std)
        state = np.broadcast_to(self.start, noise.shape).copy()
        return state, state + noise * start_std, np.diag(start_std**2)

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """True states (..., n) one step later, for noise (..., n)."""
        factor = np.linalg.cholesky(self.model.process_noise_cov(step))
        return self.model.transition(state, control, step) + noise @ factor.T

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the nodes' readings (..., nodes, 1, 2) of states (..., n) for this noise."""
        exact = self.sensors.measure(state[..., None, :], step)
        delivered = exact + noise[..., 0, :] * self.sensors.noise_std
        delivered[..., 1] = wrapped(delivered[..., 1])
        delivered[exact[..., 0] > self.field_of_view_m] = np.nan
        return delivered[..., None, :]


def turning_target(positions_m: np.ndarray, moves: Moves = ()) -> Target:
    """TRACK: a target on a circle of 250 m radius, seen from `positions_m` (nodes, 2)."""
    return Target(
        model=CoordinatedTurn(),
        sensors=RangeBearing(positions_m, moves=moves),
        start=(500.0, 12.0, 250.0, 0.0, 0.048),
        start_std=(50.0, 5.0, 50.0, 5.0, 0.02),
    )


def straight_target(positions_m: np.ndarray, moves: Moves = ()) -> Target:
    """A target that crosses the square of TRACK in two minutes, seen from `positions_m`."""
    return Target(
        model=ConstantVelocity(),
        sensors=RangeBearing(positions_m, moves=moves),
        start=(100.0, 6.0, 300.0, 3.0),
        start_std=(50.0, 5.0, 50.0, 5.0),
    )
