"""The single-track model of the ADLUKF paper against its equations in coefficients."""

import numpy as np
import pytest

from concord.features.vehicle.plant.model import linear_tyre
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.papers.adlukf.study import small_angles

CAR = BMW_320I
MODEL = small_angles(CAR, linear_tyre, 0.01)


def coefficients(state, control):
    """Derivatives and a_y as the literature writes them, k1, k2 < 0: equation 1 of the docs."""
    omega, beta, vx = state
    delta, ax = control
    k1, k2 = -CAR.front_stiffness_n_rad, -CAR.rear_stiffness_n_rad
    a, b, m, inertia = CAR.front_axle_m, CAR.rear_axle_m, CAR.mass_kg, CAR.yaw_inertia_kg_m2
    domega = (
        (a**2 * k1 + b**2 * k2) / (inertia * vx) * omega
        + (a * k1 - b * k2) / inertia * beta
        - a * k1 / inertia * delta
    )
    dbeta = (
        ((a * k1 - b * k2) / (m * vx**2) - 1) * omega
        + (k1 + k2) / (m * vx) * beta
        - k1 / (m * vx) * delta
    )
    ay = (a * k1 - b * k2) / (m * vx) * omega + (k1 + k2) / m * beta - k1 / m * delta
    return np.array([domega, dbeta, omega * beta * vx + ax]), ay


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_equation_in_coefficients(seed):
    generator = np.random.default_rng(seed)
    state = np.array([0.3, 0.05, 20.0]) * generator.uniform(0.5, 1.5, 3)
    control = generator.normal(0, [0.05, 1.0])
    derivative, ay = coefficients(state, control)
    moved = MODEL.transition(state, control, 0)
    np.testing.assert_allclose(moved, state + 0.01 * derivative, rtol=1e-12)
    np.testing.assert_allclose(MODEL.measure(state, control), [ay, state[0], state[2]], rtol=1e-12)
