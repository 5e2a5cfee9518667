"""Functions of the user's own are tried before anything starts."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from concord.plants.range_bearing import wrapped

# Leading axes with which a function is tried before anything starts.
_TRIED = (3, 2)
# Points of a state at which a function may jump; a jump between two of them is halved down.
_GRID, _HALVINGS, _CLOSE = 600, 60, 1e-3
# States drawn from the law of the first one.
_DRAWS = 200
# Distance from half a turn, in rad.
_NEAR = 1e-6

Function = Callable[[np.ndarray], ArrayLike]
"""A function of states (..., n) that keeps their leading axes."""


def require_lanes(name: str, function: Function, mean: np.ndarray, entries: int) -> None:
    """Try a function on lanes of states, and on each of them alone."""
    if not callable(function):
        kind = type(function).__name__
        raise ValueError(f"{name.partition('(')[0]} of type {kind}: must be a function of states")
    lanes = mean + np.linspace(0, 0.1, 6).reshape(*_TRIED, 1)
    try:
        with np.errstate(all="ignore"):
            together = np.asarray(function(lanes), dtype=float)
    except Exception as error:
        raise ValueError(
            f"{name} with x of shape {lanes.shape} fails ({type(error).__name__}: {error}); "
            "leading axes are free, so write x[..., 0] for the first state"
        ) from error
    if together.shape != (*_TRIED, entries):
        raise ValueError(
            f"{name} with x of shape {lanes.shape} has shape {together.shape}: must be "
            f"{(*_TRIED, entries)}; leading axes are free, so write x[..., 0] for the first state, "
            "and join results with np.stack((a, b), axis=-1)"
        )
    for lane in np.ndindex(*_TRIED):
        with np.errstate(all="ignore"):
            alone = np.asarray(function(lanes[lane]), dtype=float)
        if not np.allclose(alone, together[lane], equal_nan=True):
            raise ValueError(
                f"{name} of one state differs from {name} of several at once: it mixes the "
                "lanes; write x[..., 0] for the first state"
            )


def within_a_turn(values: np.ndarray, angles: tuple[int, ...]) -> np.ndarray:
    """Values (..., m) with those that are angles within (-pi, pi]; the same array for none."""
    if not angles:
        return values
    turned, places = np.array(values, dtype=float), list(angles)
    turned[..., places] = wrapped(turned[..., places])
    return turned


def require_angles(angles: tuple[int, ...], size: int, what: str) -> None:
    """Refuse angles that are no places of `size` states or entries, each given once."""
    places = range(size)
    is_tuple = isinstance(angles, tuple | list)
    if not is_tuple or len({*angles}) < len(angles) or any(one not in places for one in angles):
        raise ValueError(f"angles {angles}: must be some of the {what} 0 to {size - 1}, each once")


def require_one_value(
    name: str,
    function: Function,
    mean: np.ndarray,
    cov: np.ndarray,
    angles: tuple[int, ...],
    of_value: tuple[int, ...],
) -> None:
    """Refuse a function of states that jumps by a turn where its values are not named as angles.

    Args:
        name: how the function is called in messages, such as h(x).
        function: states (..., n) -> values (..., m), tried over a turn and a half of each state,
            and over three standard deviations of it.
        mean, cov: law of the first state.
        angles: states that are angles.
        of_value: values that are.

    Raises:
        ValueError: a value jumps by a turn, or depends on the turn of a state in `angles`.
    """
    deviation = np.sqrt(np.diagonal(cov))
    with np.errstate(all="ignore"):
        for state in range(len(mean)):
            for middle, reach in ((0.0, 0.75 * math.tau), (mean[state], 3 * deviation[state])):
                points = np.repeat(mean[None], _GRID, axis=0)
                points[:, state] = middle + reach * np.linspace(-1, 1, _GRID)
                _require_no_jump(name, function, points, state, angles, of_value)
        for state in angles:
            _require_same_after_a_turn(name, function, mean, state, of_value)


def _require_no_jump(
    name: str,
    function: Function,
    points: np.ndarray,
    state: int,
    angles: tuple[int, ...],
    of_value: tuple[int, ...],
) -> None:
    def value(x: np.ndarray) -> np.ndarray:
        return np.asarray(function(within_a_turn(x, angles)), dtype=float)

    def rise(x: np.ndarray) -> np.ndarray:
        return np.abs(within_a_turn(np.diff(value(x), axis=0), of_value))

    try:
        rises = rise(points)
        rises[:, np.isnan(rises).all(axis=0)] = 0.0
        usual = np.nanmedian(rises, axis=0)
        place, entry = np.argwhere(np.abs(rises - math.tau) <= 0.1 + 10 * usual)[0]
        ends = points[place : place + 2]
        for _ in range(_HALVINGS):
            middle = ends.mean(axis=0)
            left = np.stack((ends[0], middle))
            falls_left = rise(left)[0, entry] > math.tau / 2
            ends = left if falls_left else np.stack((middle, ends[1]))
        is_jump = abs(rise(ends)[0, entry] - math.tau) < _CLOSE
    # A user's function may refuse states that the plant never has; no jump is an IndexError.
    except Exception:
        return
    if is_jump:
        is_sensor = name.startswith("h")
        whose = "entry" if is_sensor else "state"
        owner = "OwnSensor" if is_sensor else "OwnPlant"
        raise ValueError(
            f"{name} jumps by 2 pi in {whose} {entry} where state {state} is "
            f"{ends[0, state]:.4g}; name it as an angle in rad, {owner}(angles=({entry},))"
        )


def _require_same_after_a_turn(
    name: str, function: Function, mean: np.ndarray, state: int, of_value: tuple[int, ...]
) -> None:
    points = np.repeat(mean[None], 4, axis=0)
    points[:, state] = np.array([np.pi, np.pi, -np.pi, -np.pi]) + _NEAR * np.array([-2, -1, 1, 2])
    try:
        values = np.asarray(function(points), dtype=float)
    except Exception:  # as above
        return
    around, usual = (
        np.abs(within_a_turn(values[one] - values[other], of_value))
        for one, other in ((1, 2), (0, 1))
    )
    wrong = around > 100 * (usual + _NEAR * (1 + np.abs(values[1])))
    if wrong.any():
        entry = int(np.argmax(wrong))
        raise ValueError(
            f"{name} has {values[1, entry]:.4g} in entry {entry} where state {state} is just below "
            f"pi, and {values[2, entry]:.4g} just above -pi: angles has this state, so both must "
            "be alike; use the sine and cosine of it, or take it out of angles"
        )


def require_finite(name: str, function: Function, mean: np.ndarray, cov: np.ndarray) -> None:
    """Refuse a function that is not finite for states that the first one may be.

    Raises:
        ValueError: naming a state and the value there.
    """
    states = _drawn(mean, cov)
    with np.errstate(all="ignore"):
        values = np.asarray(function(states), dtype=float)
    wrong = ~np.isfinite(values).all(axis=-1)
    if wrong.any():
        which = int(np.argmax(wrong))
        raise ValueError(
            f"{name} is {values[which].tolist()} where x is {np.round(states[which], 6).tolist()}, "
            f"and so for {np.count_nonzero(wrong)} of {len(states)} states drawn from mean and "
            "cov; let it be finite there, or lower cov"
        )


def require_dependence(
    name: str, function: Function, mean: np.ndarray, cov: np.ndarray, angles: tuple[int, ...]
) -> None:
    """Refuse a sensor function that has one value for all states.

    Raises:
        ValueError: naming the value.
    """
    reach = 30 * (np.sqrt(np.diagonal(cov)) + 1e-3 * np.abs(mean))
    # A state known to be 0 has no scale of its own.
    reach = np.where(reach > 0, reach, 1.0)
    wide = [mean + sign * np.diag(reach) for sign in (-1, 1)]
    states = within_a_turn(np.concatenate((_drawn(mean, cov), *wide)), angles)
    try:
        with np.errstate(all="ignore"):
            values = np.asarray(function(states), dtype=float)
    # A function may refuse states that the plant never has.
    except Exception:
        return
    if np.isfinite(values).all() and (values == values[0]).all():
        raise ValueError(
            f"{name} is {values[0].tolist()} for every state, so its readings say nothing of the "
            "plant; let it depend on x, or give None for a blind node"
        )


def _drawn(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """States (K, n) drawn from a law, the same ones always."""
    values, vectors = np.linalg.eigh(cov)
    normals = np.random.default_rng(1).standard_normal((_DRAWS, len(mean)))
    return mean + normals @ (vectors * np.sqrt(np.maximum(values, 0))).T
