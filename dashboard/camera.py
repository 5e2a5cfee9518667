"""Where a scene is looked at from, so that all of it is seen beside the panels that cover it."""

from typing import NamedTuple

import numpy as np

from dashboard.frame import Array

FIELD_OF_VIEW_RAD = 0.85
# From the south, nearer to a map than to the horizon.
_TILT_RAD = np.deg2rad(36.0)
_TOWARDS_EYE = np.array([0.0, -np.sin(_TILT_RAD), np.cos(_TILT_RAD)])
_RIGHT = np.array([1.0, 0.0, 0.0])
_UP = np.cross(_TOWARDS_EYE, _RIGHT)
_TURNS = 30


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


def aimed(points: Array, free: Free) -> Camera:
    """The nearest camera that sees all points (P, 3) in the free part of its window.

    The direction is fixed. By turns the camera is moved sideways until the points are in the middle
    of the free part, and away from them until they fit.
    """
    look_at, distance = points.mean(axis=0), 2.0 * float(np.ptp(points, axis=0).max() + 1.0)
    wanted = np.array([free.left + free.right, free.top + free.bottom]) / 2
    room = np.array([free.right - free.left, free.bottom - free.top])
    for _ in range(_TURNS):
        low, high = _span(pixels(points, Camera(_eye(look_at, distance), _tuple(look_at)), free))
        off = ((low + high) / 2 - wanted) * distance / _focal(free)
        look_at = look_at + off[0] * _RIGHT - off[1] * _UP
        distance *= float(np.sqrt(((high - low) / room).max()))
    return Camera(_eye(look_at, distance), _tuple(look_at))


def pixels(points: Array, camera: Camera, free: Free) -> Array:
    """Where points (P, 3) are in the window of such a camera: (P, 2), from the upper left."""
    off = points - np.array(camera.look_at)
    distance = float(np.linalg.norm(np.subtract(camera.position, camera.look_at)))
    # No nearer than a little: behind the camera there is no picture.
    depth = np.maximum(distance - off @ _TOWARDS_EYE, 0.05 * distance)
    flat = np.stack([off @ _RIGHT, -(off @ _UP)], axis=-1) / depth[:, None] * _focal(free)
    return flat + np.array([free.width, free.height]) / 2


def _focal(free: Free) -> float:
    return free.height / 2 / float(np.tan(FIELD_OF_VIEW_RAD / 2))


def _span(points: Array) -> tuple[Array, Array]:
    return points.min(axis=0), points.max(axis=0)


def _eye(look_at: Array, distance: float) -> tuple[float, float, float]:
    return _tuple(look_at + distance * _TOWARDS_EYE)


def _tuple(point: Array) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z
