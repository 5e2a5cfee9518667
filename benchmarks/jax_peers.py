"""Many filters by libraries on JAX (vmap and jit, float64): dynamax's unscented and cuthbert's
extended filter, in seconds a lane and step; nothing where they are not installed (`make bench`).
"""

# The development environment has none of them, nor JAX; `make peers` installs them. They take
# numpy's arrays for JAX's, and their types do not say so.
# pyright: reportMissingImports=false, reportArgumentType=false, reportOptionalSubscript=false

import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from benchmarks.cases import SENSOR_POSITION_M, BenchmarkCase, readings

_NAMES = ("dynamax", "cuthbert")


def jax_loops(case: BenchmarkCase, lanes: int, steps: int) -> dict[str, Callable[[], float]]:
    """The loops of the libraries that are installed, by name."""
    return {
        name: _timed(make(case, steps), case, lanes, steps)
        for name, make in {"dynamax": _dynamax, "cuthbert": _cuthbert}.items()
        if find_spec(name) is not None
    }


def installed() -> str:
    """The libraries with their versions; how they are installed where there is none."""
    found = [f"{name} {version(name)}" for name in _NAMES if find_spec(name) is not None]
    return ", ".join(found) or "dynamax and cuthbert are not installed (make peers)"


def _timed(filtered: Callable, case: BenchmarkCase, lanes: int, steps: int) -> Callable[[], float]:
    """Compile for all lanes; a run takes the processor time of every thread."""
    import jax

    taken = jax.numpy.asarray(readings(case, (lanes,)))
    compiled = jax.jit(jax.vmap(filtered))
    compiled(taken)[0].block_until_ready()

    def run() -> float:
        started = time.process_time()
        compiled(taken)[0].block_until_ready()
        return (time.process_time() - started) / (steps * lanes)

    run.filtered = filtered  # type: ignore[attr-defined]
    return run


def _dynamax(case: BenchmarkCase, steps: int) -> Callable:
    """Update, then predict, `steps` times with one reading; alpha, beta, kappa of concord."""
    import jax
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, UKFHyperParams, unscented_kalman_filter

    jax.config.update("jax_enable_x64", True)
    transition, measure = _models(case)
    n = len(case.start.mean)
    params = ParamsNLGSSM(
        *case.start, transition, case.process_noise_cov, measure, case.measurement_noise_cov
    )
    spread = UKFHyperParams(1.0, 2, 3 - n)

    def filtered(reading):
        emissions = jax.numpy.broadcast_to(reading, (steps, 2))
        fields = ["predicted_means", "predicted_covariances"]
        kept = unscented_kalman_filter(params, emissions, spread, output_fields=fields)
        return kept.predicted_means[-1], kept.predicted_covariances[-1]

    return filtered


def _cuthbert(case: BenchmarkCase, steps: int) -> Callable:
    """Predict, then update: square roots of covariances, slopes by automatic differentiation."""
    import jax
    from cuthbert import filter as run_filter
    from cuthbert.gaussian.moments import build_filter

    jax.config.update("jax_enable_x64", True)
    transition, measure = _models(case)
    root, noise_root = (
        np.linalg.cholesky(cov) for cov in (case.process_noise_cov, case.measurement_noise_cov)
    )
    extended = build_filter(
        case.start.mean,
        np.linalg.cholesky(case.start.cov),
        lambda state, _: (lambda x: (transition(x), root), state.mean),
        lambda state, reading: (lambda x: (measure(x), noise_root), state.mean, reading),
    )

    def filtered(reading):
        emissions = jax.numpy.broadcast_to(reading, (steps, 2))
        kept = run_filter(extended, emissions, extended.init_prepare())
        return kept.mean[-1], kept.chol_cov[-1]

    return filtered


def _models(case: BenchmarkCase) -> tuple[Callable, Callable]:
    """The case's models in numbers of JAX; bearings are not wrapped, as the case needs it not."""
    import jax.numpy as jnp

    def straight(x):
        return jnp.array([x[0] + x[1], x[1], x[2] + x[3], x[3]])

    def turn(x):
        px, vx, py, vy, rate = x
        sine, cosine = jnp.sin(rate), jnp.cos(rate)
        a, b = sine / rate, (1 - cosine) / rate
        after_x, after_y = px + a * vx - b * vy, py + b * vx + a * vy
        return jnp.array([after_x, cosine * vx - sine * vy, after_y, sine * vx + cosine * vy, rate])

    def bearing(x):
        dx, dy = x[0] - SENSOR_POSITION_M[0], x[2] - SENSOR_POSITION_M[1]
        return jnp.array([jnp.sqrt(dx * dx + dy * dy), jnp.arctan2(dy, dx)])

    if case.name == "A":
        return straight, lambda x: jnp.array([x[0], x[2]])
    return turn, bearing
