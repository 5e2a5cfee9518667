"""A plant of the user's own, as a plain function and covariances."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.own_motion import RK4, Inputs, OwnMotion, bound, motion_of
from concord.plants.own_trials import (
    Function,
    require_angles,
    require_finite,
    require_lanes,
    require_one_value,
    within_a_turn,
)
from concord.plants.own_values import (
    covariance_of,
    numbers_of,
    require_description,
    require_parameters,
    vector_of,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnPlant:
    """x(k + 1) = f(x(k)) + w, w normal with covariance Q; also the model of the nodes' filters.

    Attributes:
        f: f(x), f(x, u) or f(x, u, k): states (..., n), input (p,) and step -> states (..., n), one
            step later.
        Q: covariance of the process noise of a step, (n, n), or its diagonal (n,).
        dynamics: in place of f, g(x), g(x, u) or g(x, u, t): the derivative (..., n) of states by
            time, with the input held over a step, at the time t in s.
        integrator: of dynamics: rk4, one step of Runge and Kutta's fourth order; or Radau, BDF or
            LSODA of scipy, for stiff systems.
        inputs: (steps, p), u(k) from step k to k + 1, or a function of k; None for none.
        mean, cov: law of the first state and prior of every filter, (n,) and (n, n) or (n,).
        time_step_s: sampling time.
        state_names, state_units: of each state; x0, x1, ... without units when left out.
        positions: places of the nodes in m, (nodes, 2), for geometric graphs and pictures.
        angles: states that are angles in rad. f and h get them within (-pi, pi], and f may return
            them on any turn. Recorded states count turns, so that they have no jumps.
        parameters: value, least and largest, (value, low, high), of what f, dynamics and the h of
            sensors take by keyword, as in f(x, u, mass=1.0); `concord identify` seeks them.

    Raises:
        ValueError: shapes that do not fit, inputs that the function does not take, a matrix that
            is no covariance, or an f that does not keep leading axes. An f that jumps by a turn in
            a state that is not in `angles`.
    """

    f: Callable[..., ArrayLike] | None = None
    Q: ArrayLike
    mean: ArrayLike
    cov: ArrayLike
    dynamics: Callable[..., ArrayLike] | None = None
    integrator: str = RK4
    inputs: Inputs = None
    time_step_s: float = 1.0
    state_names: tuple[str, ...] = ()
    state_units: tuple[str, ...] = ()
    positions: ArrayLike | None = None
    angles: tuple[int, ...] = ()
    parameters: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = self.states
        require_description(n, self.time_step_s, self.state_names, self.state_units)
        require_angles(self.angles, n, "states")
        law = self.prior_mean, self.prior_cov
        require_parameters(self.parameters)
        _ = self.noise_cov, self.places
        first, call = self.motion.at(0), self.motion.call
        require_lanes(call, first, self.prior_mean, n)
        require_finite(call, first, *law)
        if self.dynamics is None:
            require_one_value(call, first, *law, self.angles, self.angles)

    @cached_property
    def motion(self) -> OwnMotion:
        """How the states move."""
        return motion_of(
            self.f, self.dynamics, self.inputs, self.integrator, self.time_step_s, self.values
        )

    @property
    def values(self) -> dict[str, float]:
        """The value of each parameter."""
        return {name: float(one[0]) for name, one in self.parameters.items()}

    def with_values(self, values: Mapping[str, float]) -> "OwnPlant":
        """The plant with other values of its parameters."""
        changed = {name: (value, *self.parameters[name][1:]) for name, value in values.items()}
        return replace(self, parameters={**self.parameters, **changed})

    @property
    def states(self) -> int:
        """Number of states n."""
        return len(self.prior_mean)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.state_names or tuple(f"x{i}" for i in range(self.states))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the states; "" where the user named none."""
        return self.state_units or ("",) * self.states

    @cached_property
    def prior_mean(self) -> np.ndarray:
        """Mean (n,) of the first state."""
        return vector_of("mean", self.mean)

    @cached_property
    def prior_cov(self) -> np.ndarray:
        """Covariance (n, n) of the first state."""
        return covariance_of("cov", self.cov, self.states)

    @cached_property
    def noise_cov(self) -> np.ndarray:
        """Covariance (n, n) of the process noise."""
        return covariance_of("Q", self.Q, self.states)

    @cached_property
    def places(self) -> np.ndarray | None:
        """Places (nodes, 2) of the nodes in m; None where the user named none."""
        if self.positions is None:
            return None
        places = numbers_of("positions", self.positions)
        if places.ndim != 2 or places.shape[1] != 2 or not np.isfinite(places).all():
            raise ValueError(
                f"positions of shape {places.shape}: must be (nodes, 2), two finite numbers in m"
            )
        return places

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., n) one step later, without noise; angles less than half a turn away."""
        f = self.motion.at(step)
        moved = np.asarray(f(within_a_turn(state, self.angles)), dtype=float)
        if not self.angles:
            return moved
        changed = within_a_turn(moved - state, self.angles)
        places = list(self.angles)
        turned = moved.copy()
        turned[..., places] = (state + changed)[..., places]
        return turned

    def of_turned(self, h: Function) -> Function:
        """A function of states (..., n) that gets angles within (-pi, pi], and parameters."""
        h = bound("h", h, self.values)
        if not self.angles:
            return h
        return lambda x: h(within_a_turn(x, self.angles))

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) that a step adds."""
        return self.noise_cov
