"""Where a drive leaves the single-track model.

The model has no standstill and no load transfer, and the force of its tyres has no peak. So it
holds above walking pace, below most of the friction, and up to a slip of seven degrees. There tyres
on a dry road are about at their peak (Pacejka 2012, Tyre and vehicle dynamics, chapter 1).
"""

import numpy as np

from concord.features.vehicle.plant.model import SPEED, YAW_RATE, SingleTrack
from concord.features.vehicle.plant.network import STEERING

SLOWEST_M_S = 3.0
LARGEST_SLIP_RAD = 0.12
FRICTION_USED = 0.8
"""Greatest lateral acceleration, over that of all tyres at their friction limit."""


def outside_model(track: SingleTrack, states: np.ndarray) -> dict[str, np.ndarray]:
    """Which states (..., 6) of `network` the model does not hold for (...), by the reason."""
    moving, inputs = states[..., : SPEED + 1], states[..., STEERING:]
    slips = track.axle_slips(moving, inputs[..., 0])
    felt = np.abs(moving[..., YAW_RATE] * moving[..., SPEED])
    limit = FRICTION_USED * (track.axles.front_limit + track.axles.rear_limit) / track.car.mass_kg
    return {
        f"below {SLOWEST_M_S:g} m/s": moving[..., SPEED] < SLOWEST_M_S,
        f"slip of an axle above {LARGEST_SLIP_RAD:g} rad": (
            np.maximum(*np.abs(slips)) > LARGEST_SLIP_RAD
        ),
        f"lateral acceleration above {limit:.2g} m/s²": felt > limit,
    }
