"""How a plant of the user's own moves: f or dynamics of states, inputs and steps."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.own_trials import Function
from concord.plants.own_values import numbers_of

RK4 = "rk4"
_STIFF = ("Radau", "BDF", "LSODA")
INTEGRATORS = (RK4, *_STIFF)
"""One step of Runge and Kutta's fourth order; or one of scipy's `solve_ivp`, for stiff systems."""
_RELATIVE, _ABSOLUTE = 1e-8, 1e-10  # tolerances of scipy's integrators

Inputs = ArrayLike | Callable[[int], ArrayLike] | None


@dataclass(frozen=True, eq=False)
class OwnMotion:
    """States one step later, without noise.

    Attributes:
        name: "f" or "dynamics".
        function: of the user.
        arguments: how many of x, u and k (the time in s, for dynamics) it takes.
        inputs: (steps, p), u(k) from step k to k + 1; a function of k; None for none.
        integrator: of `INTEGRATORS`, for dynamics.
        time_step_s: sampling time.
    """

    name: str
    function: Callable[..., ArrayLike]
    arguments: int
    inputs: np.ndarray | Callable[[int], ArrayLike] | None
    integrator: str
    time_step_s: float

    @property
    def call(self) -> str:
        """How the user's function is called, for messages: "f(x, u)"."""
        last = "k" if self.name == "f" else "t"
        return f"{self.name}({', '.join(('x', 'u', last)[: self.arguments])})"

    @property
    def most_steps(self) -> int | None:
        """Steps that the inputs last; None where they have no end."""
        return len(self.inputs) + 1 if isinstance(self.inputs, np.ndarray) else None

    def at(self, step: int) -> Function:
        """The function of states (..., n) that moves them from a step to the next.

        Raises:
            ValueError: an input that is no vector of finite numbers.
        """
        rest = () if self.arguments == 1 else (self._input(step), step)
        if self.name == "f":
            return lambda x: self.function(x, *rest[: self.arguments - 1])
        start_s = self.time_step_s * step

        def rate(x: np.ndarray, time_s: float) -> np.ndarray:
            given = (*rest[:1], time_s)[: self.arguments - 1]
            return np.asarray(self.function(x, *given), dtype=float)

        if self.integrator == RK4:
            return lambda x: _runge_kutta(rate, x, start_s, self.time_step_s)
        return lambda x: _solved(rate, x, start_s, self.time_step_s, self.integrator)

    def _input(self, step: int) -> np.ndarray:
        if self.inputs is None:
            return np.empty(0)
        if isinstance(self.inputs, np.ndarray):
            # A run is refused that has more steps; what looks ahead of one holds the last.
            return self.inputs[min(step, len(self.inputs) - 1)]
        value = np.atleast_1d(numbers_of(f"inputs({step})", self.inputs(step)))
        if value.ndim != 1 or not np.isfinite(value).all():
            raise ValueError(
                f"inputs({step}) is {value.tolist()}: must be a number or a vector of finite ones"
            )
        return value


def bound(
    name: str, function: Callable[..., ArrayLike], parameters: Mapping[str, float]
) -> Callable[..., ArrayLike]:
    """A function with the parameters that it takes by keyword.

    Raises:
        ValueError: it must be given a keyword that is no parameter.
    """
    try:
        asked = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return function
    keywords = [one for one in asked if one.kind == one.KEYWORD_ONLY]
    taken = {one.name: parameters[one.name] for one in keywords if one.name in parameters}
    for one in keywords:
        if one.default is one.empty and one.name not in taken:
            raise ValueError(
                f"{name} takes {one.name} by keyword, and the plant has no such parameter; give "
                f"parameters={{{one.name!r}: (value, low, high)}}"
            )
    return partial(function, **taken) if taken else function


def motion_of(
    f: Callable[..., ArrayLike] | None,
    dynamics: Callable[..., ArrayLike] | None,
    inputs: Inputs,
    integrator: str,
    time_step_s: float,
    parameters: Mapping[str, float],
) -> OwnMotion:
    """Return the motion of a plant's fields.

    Raises:
        ValueError: both functions or none, another number of arguments than 1 to 3, inputs that
            the function does not take, or that are missing.
    """
    if (f is None) == (dynamics is None):
        raise ValueError(
            f"f and dynamics: {'none' if f is None else 'both'} given; give one, f for the state a "
            "step later, or dynamics for its derivative by time"
        )
    if integrator not in INTEGRATORS:
        raise ValueError(f"integrator {integrator!r}: must be one of {', '.join(INTEGRATORS)}")
    name = "dynamics" if f is None else "f"
    function: Any = dynamics if f is None else f
    _require_callable(name, function)
    function = bound(name, function, parameters)
    given: Any = _inputs(inputs)
    motion = OwnMotion(name, function, _arguments(name, function), given, integrator, time_step_s)
    if motion.arguments == 1 and given is not None:
        raise ValueError(
            f"inputs: {motion.call} takes no input; write {name}(x, u), or leave inputs out"
        )
    if motion.arguments == 2 and given is None:
        raise ValueError(
            f"inputs: {motion.call} takes an input, and there is none; give inputs=, an array "
            "(steps, p) or a function of the step, or write a function of x alone"
        )
    return motion


def _require_callable(name: str, function: Any) -> None:
    if not callable(function):
        raise ValueError(f"{name} of type {type(function).__name__}: must be a function of states")


def _arguments(name: str, function: Callable[..., ArrayLike]) -> int:
    """How many arguments a function must be given; 1 of one that does not say."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 1
    asked = [
        one
        for one in parameters
        if one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD) and one.default is one.empty
    ]
    if len(asked) not in (1, 2, 3):
        last = "k" if name == "f" else "t"
        raise ValueError(
            f"{name} takes {len(asked)} arguments ({', '.join(one.name for one in asked)}); write "
            f"{name}(x), {name}(x, u) or {name}(x, u, {last})"
        )
    return len(asked)


def _inputs(given: Any) -> Any:
    if given is None or callable(given):
        return given
    inputs = numbers_of("inputs", given)
    inputs = inputs[:, None] if inputs.ndim == 1 else inputs
    if inputs.ndim != 2 or not len(inputs):
        raise ValueError(f"inputs of shape {inputs.shape}: must be (steps, p), or (steps,)")
    if not np.isfinite(inputs).all():
        step, entry = np.argwhere(~np.isfinite(inputs))[0].tolist()
        raise ValueError(
            f"inputs: entry {entry} is {inputs[step, entry]} at step {step}; give a finite number "
            "for each step, such as the last one before"
        )
    return inputs


def _runge_kutta(
    rate: Callable[[np.ndarray, float], np.ndarray], x: np.ndarray, start_s: float, step_s: float
) -> np.ndarray:
    """Return states (..., n) after one step of the classical method of fourth order."""
    half_s = 0.5 * step_s
    first = rate(x, start_s)
    second = rate(x + half_s * first, start_s + half_s)
    third = rate(x + half_s * second, start_s + half_s)
    fourth = rate(x + step_s * third, start_s + step_s)
    return x + step_s / 6 * (first + 2 * second + 2 * third + fourth)


def _solved(
    rate: Callable[[np.ndarray, float], np.ndarray],
    x: np.ndarray,
    start_s: float,
    step_s: float,
    method: str,
) -> np.ndarray:
    """Return states (..., n) after one step by scipy; NaN where its integrator gave up.

    Each lane is solved alone, so that its steps do not depend on the others.
    """
    # Only here: most plants need no integrator of scipy.
    from scipy.integrate import solve_ivp

    moved = np.empty(x.shape)
    for lane in np.ndindex(x.shape[:-1]):
        solution = solve_ivp(
            lambda time_s, state: rate(state, float(time_s)),
            (start_s, start_s + step_s),
            x[lane],
            method=method,
            t_eval=(start_s + step_s,),
            rtol=_RELATIVE,
            atol=_ABSOLUTE,
        )
        moved[lane] = solution.y[:, -1] if solution.success else np.nan
    return moved
