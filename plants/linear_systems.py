"""Linear systems of other libraries as plants of the user's own."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.own_motion import Inputs
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.plants.own_values import covariance_of, numbers_of


def from_control(
    system: Any,
    *,
    Q: ArrayLike,
    R: ArrayLike,
    mean: ArrayLike,
    cov: ArrayLike,
    time_step_s: float | None = None,
    inputs: Inputs = None,
) -> tuple[OwnPlant, OwnSensor]:
    """The plant and the sensor of a linear system; its inputs are 0 where none are given.

    Args:
        system: a `control.StateSpace`, or a state space of scipy.signal; a continuous one is
            sampled at `time_step_s`.
        Q: covariance of the process noise of a step, (n, n) or (n,).
        R: covariance of the noise of its outputs, (m, m) or (m,).
        mean, cov: law of the first state, as in `OwnPlant`.
        time_step_s: sampling time; that of the system when left out.
        inputs: as in `OwnPlant`, one for each column of B, held over a step.

    Raises:
        ValueError: no state space, one that leaves open whether it is continuous, one without a
            sampling time, or one of another than `time_step_s`. Inputs of another number than B
            has, or of a system whose D is not 0.
    """
    kind = type(system).__name__
    if not all(hasattr(system, name) for name in "ABCD"):
        raise ValueError(
            f"system: a {kind} has no states for mean, cov and Q; give control.StateSpace, which "
            "control.ss makes of a transfer function, or scipy.signal.StateSpace"
        )
    sampled_s = _step_s(system, time_step_s)
    if _is_continuous(system):
        sampled = system.to_discrete if hasattr(system, "to_discrete") else system.sample
        system = sampled(sampled_s)
    transition, output = numbers_of("A", system.A), numbers_of("C", system.C)
    if not (np.isfinite(transition).all() and np.isfinite(output).all()):
        raise ValueError("system: A and C must be finite")
    gain = numbers_of("B", system.B)
    if inputs is not None:
        _check_inputs(inputs, gain, numbers_of("D", system.D))
    names = tuple(map(str, getattr(system, "state_labels", None) or ()))
    plant = OwnPlant(
        f=_motion(transition, None if inputs is None else gain),
        inputs=inputs,
        Q=Q,
        mean=mean,
        cov=cov,
        time_step_s=sampled_s,
        state_names=names,
    )
    outputs = tuple((str(one), "") for one in getattr(system, "output_labels", None) or ())
    noise_cov = covariance_of("R", R, len(output))
    return plant, OwnSensor(h=lambda x: x @ output.T, R=noise_cov, channels=outputs)


def _motion(transition: np.ndarray, gain: np.ndarray | None) -> Callable[..., np.ndarray]:
    if gain is None:
        return lambda x: x @ transition.T
    return lambda x, u: x @ transition.T + u @ gain.T


def _check_inputs(inputs: Any, gain: np.ndarray, through: np.ndarray) -> None:
    if through.any():
        raise ValueError(
            "inputs: D of the system is not 0, so the outputs have a part that no state tells; "
            "take it off the readings, and make D 0"
        )
    one = numbers_of("inputs", inputs(0) if callable(inputs) else inputs)
    columns = one.size if callable(inputs) else one.shape[-1] if one.ndim > 1 else 1
    if columns != gain.shape[1]:
        raise ValueError(
            f"inputs: {columns} for the {gain.shape[1]} columns of B; give one for each"
        )


def _is_continuous(system: Any) -> bool:
    # scipy says None, python-control 0; there None leaves it open.
    if type(system).__module__.startswith("scipy"):
        return system.dt is None
    return not isinstance(system.dt, bool) and system.dt == 0


def _step_s(system: Any, asked_s: float | None) -> float:
    """The sampling time of a system, as the system or the caller says it.

    Raises:
        ValueError: neither does, both differ, or the system may be continuous or not.
    """
    own: Any = system.dt
    if own is None and not _is_continuous(system):
        raise ValueError(
            "system with dt None: it may be continuous or sampled; give it dt 0 for continuous, or "
            "its sampling time"
        )
    # True says sampled, at a time unknown; it equals 1.
    is_open = own is None or isinstance(own, bool) or _is_continuous(system)
    own_s = None if is_open else float(system.dt)
    if asked_s is None:
        if own_s is None:
            raise ValueError("the system has no sampling time; give time_step_s")
        return own_s
    is_time = isinstance(asked_s, int | float | np.number) and not isinstance(asked_s, bool)
    if not (is_time and 0 < asked_s < np.inf):
        raise ValueError(f"time_step_s {asked_s}: must be a finite number above 0")
    if own_s is not None and not np.isclose(asked_s, own_s, rtol=1e-9, atol=0):
        raise ValueError(f"time_step_s {asked_s}: the system is sampled at {own_s} s; leave it out")
    return float(asked_s) if own_s is None else own_s
