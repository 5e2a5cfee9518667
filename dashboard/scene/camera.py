"""Where a scene is looked at from, so that all of it is seen beside the panels that cover it."""

from typing import NamedTuple

import numpy as np

FIELD_OF_VIEW_RAD = 0.85
# From the south, nearer to a map than to the horizon.
_TILT_RAD = np.deg2rad(36.0)
_TOWARDS_EYE = np.array([0.0, -np.sin(_TILT_RAD), np.cos(_TILT_RAD)])
_RIGHT = np.array([1.0, 0.0, 0.0])
_UP = np.cross(_TOWARDS_EYE, _RIGHT)
# No point comes nearer to the eye.
_NEAREST_M = 0.1


class Free(NamedTuple):
    """A window of `width` times `height` pixels, and the part of it that no panel covers."""

    width: float
    height: float
    left: float
    top: float
    right: float
    bottom: float


class Camera(NamedTuple):
    """Where a scene is looked at from, and what is in the middle of the picture."""

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]


def aimed(points: np.ndarray, free: Free) -> Camera:
    """Return the nearest camera that sees all points (P, 3) in the free part of its window.

    The direction is fixed. At depth z in front of the eye the free part reaches from `low` z to
    `high` z, to the right and upwards; so each point bounds the place of the eye, linearly.
    """
    middle = np.array([free.width, free.height]) / 2
    sides = (np.array([[free.left, free.bottom], [free.right, free.top]]) - middle) / _focal(free)
    low, high = sides * [1.0, -1.0]
    flat, near = points @ np.stack([_RIGHT, _UP], axis=-1), points @ _TOWARDS_EYE
    least = (flat + low * near[:, None]).min(axis=0)
    most = (flat + high * near[:, None]).max(axis=0)
    distance = max(float(((most - least) / (high - low)).max()), float(near.max()) + _NEAREST_M)
    # Where it does not matter, the same room is left on both sides.
    right, up = ((most - high * distance) + (least - low * distance)) / 2
    eye = right * _RIGHT + up * _UP + distance * _TOWARDS_EYE
    return Camera(_tuple(eye), _tuple(eye - (distance - near.mean()) * _TOWARDS_EYE))


def _focal(free: Free) -> float:
    return free.height / 2 / float(np.tan(FIELD_OF_VIEW_RAD / 2))


def _tuple(point: np.ndarray) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z
