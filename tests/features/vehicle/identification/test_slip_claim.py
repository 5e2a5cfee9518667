"""The factor by which a car claims larger errors of its side slip."""

import numpy as np
import pytest

from concord.features.vehicle.identification.slip_claim import FACTORS, least_covering


@pytest.mark.parametrize("factor", [1.0, 1.5, 5.0, 60.0])
def test_errors_that_stay_ask_for_the_root_of_their_anees(factor: float):
    assert least_covering((factor / FACTORS) ** 2) == pytest.approx(factor)


def test_a_filter_that_fails_with_much_noise_does_not_ask_for_more():
    """Half of a real drive had ANEES 2.65, and 1.07 with 64 times the noise; its car got that."""
    of_drive = np.array(
        [2.65, 1.38, 0.71, 0.37, 0.2, 0.11, 0.07, 0.05, 0.04, 0.04, 0.02, 0.24, 1.07]
    )
    assert FACTORS[1] < least_covering(of_drive) < FACTORS[2]


def test_where_no_factor_covers_the_best_is_taken():
    anees = np.full(len(FACTORS), 9.0)
    anees[4] = 3.0
    assert least_covering(anees) == pytest.approx(FACTORS[4])


def test_errors_within_the_claim_ask_for_nothing():
    assert least_covering(0.5 / FACTORS) == 1.0
