"""Linear systems of other libraries as plants of the user's own."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.own_plant import OwnPlant, OwnSensor


def from_control(
    system: Any,
    *,
    Q: ArrayLike,
    R: ArrayLike,
    mean: ArrayLike,
    cov: ArrayLike,
    time_step_s: float | None = None,
) -> tuple[OwnPlant, OwnSensor]:
    """The plant and the sensor of a `control.StateSpace`, without its inputs.

    Args:
        system: a linear system; a continuous one is sampled at `time_step_s`.
        Q: covariance of the process noise of a step, (n, n) or (n,).
        R: covariance of the noise of its outputs, (m, m) or (m,).
        mean, cov: law of the first state, as in `OwnPlant`.
        time_step_s: sampling time; that of the system when left out.

    Raises:
        ValueError: a system without a sampling time, or one of another than `time_step_s`.
    """
    is_continuous = system.dt in (None, 0, True)
    if is_continuous and time_step_s is None:
        raise ValueError("the system has no sampling time; give time_step_s")
    if not is_continuous and time_step_s not in (None, system.dt):
        raise ValueError(
            f"time_step_s {time_step_s}: the system is sampled at {system.dt} s; leave it out"
        )
    if system.dt == 0:
        system = system.sample(time_step_s)
    transition, output = np.asarray(system.A, dtype=float), np.asarray(system.C, dtype=float)
    sampled_s = float(system.dt) if not is_continuous else float(time_step_s or 0)
    names = tuple(map(str, getattr(system, "state_labels", None) or ()))
    plant = OwnPlant(
        f=lambda x: x @ transition.T,
        Q=Q,
        mean=mean,
        cov=cov,
        time_step_s=sampled_s,
        state_names=names,
    )
    return plant, OwnSensor(h=lambda x: x @ output.T, R=R)
