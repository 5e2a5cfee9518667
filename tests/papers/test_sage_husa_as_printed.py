"""Sage-Husa adaptation as the ADLUKF paper prints it: its equations, its bounds, a failed step."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from concord.papers.adlukf import sage_husa_as_printed as sage_husa_literal
from concord.papers.adlukf.sage_husa_as_printed import NoiseEvidence


def evidence(generator: np.random.Generator, scale: float = 1.0) -> NoiseEvidence:
    def draw(size: int) -> np.ndarray:
        return scale * generator.standard_normal((5, size))

    return NoiseEvidence(
        draw(2), draw(3), draw(3) ** 2, draw(3), draw(3) ** 2, draw(2), draw(2) ** 2
    )


def test_the_printed_form_is_the_papers_equations():
    generator = np.random.default_rng(7)
    noise = sage_husa_literal.begin(np.full((5, 3), 0.1), np.full((5, 2), 0.2))
    said = evidence(generator)
    after = sage_husa_literal.adapt(noise, said, forgetting=0.95, means=True)
    d = (1 - 0.95) / (1 - 0.95**2)
    e, Ke = said.innovation, said.correction
    Q = (1 - d) * 0.1 + d * (Ke**2 + said.posterior_variances - said.process_spread)
    R = (1 - d) * 0.2 + d * (e**2 - said.measurement_spread)
    np.testing.assert_allclose(after.process_variances, np.abs(Q), rtol=1e-12)
    np.testing.assert_allclose(after.measurement_variances, np.abs(R), rtol=1e-12)
    np.testing.assert_allclose(after.process_mean, d * said.process_residual, rtol=1e-12)
    np.testing.assert_allclose(after.measurement_mean, d * said.measurement_residual, rtol=1e-12)
    without = sage_husa_literal.adapt(noise, said, forgetting=0.95)
    assert (without.process_mean == 0).all()
    assert (without.measurement_mean == 0).all()


@given(seed=st.integers(0, 1000), scale=st.sampled_from([1e-9, 1.0, 1e6]))
def test_the_printed_form_stays_within_its_bounds(seed, scale):
    generator = np.random.default_rng(seed)
    noise = sage_husa_literal.begin(np.full(3, 1e-5), np.full(2, 1e-2))
    for _ in range(4):
        noise = sage_husa_literal.adapt(noise, evidence(generator, scale))
    assert ((noise.process_variances >= 1e-14) & (noise.process_variances <= 1e2)).all()
    assert ((noise.measurement_variances >= 1e-8) & (noise.measurement_variances <= 1e4)).all()


def test_a_failed_step_leaves_the_printed_statistics():
    noise = sage_husa_literal.begin(np.full((5, 3), 0.1), np.full((5, 2), 0.2))
    said = evidence(np.random.default_rng(7))
    said.innovation[2] = np.nan
    after = sage_husa_literal.adapt(noise, said)
    np.testing.assert_array_equal(after.process_variances[2], 0.1)
    np.testing.assert_array_equal(after.measurement_variances[2], 0.2)
    np.testing.assert_array_equal(after.taken, [1, 1, 0, 1, 1])
