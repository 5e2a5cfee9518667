"""Where scenes are looked at from: all of them is seen, as large as panels allow."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dashboard.camera import FIELD_OF_VIEW_RAD, Free, aimed, pixels

places = st.tuples(*(st.floats(-15, 15) for _ in range(2)), st.floats(0, 3))
clouds = st.lists(places, min_size=3, max_size=12).map(np.array)
windows = st.builds(
    lambda width, height, right, bottom: Free(
        width, height, 20.0, 30.0, right * width, bottom * height
    ),
    st.floats(600, 2000), st.floats(500, 1100), st.floats(0.4, 1.0), st.floats(0.4, 1.0),
)  # fmt: skip


def pinhole(points: np.ndarray, camera, free: Free) -> np.ndarray:
    """The textbook's camera: rows of the rotation are right, down and ahead."""
    position = np.array(camera.position)
    ahead = np.array(camera.look_at) - position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = (points - position) @ np.stack([right, np.cross(ahead, right), ahead]).T
    focal = free.height / (2 * np.tan(FIELD_OF_VIEW_RAD / 2))
    return focal * seen[:, :2] / seen[:, 2:] + [free.width / 2, free.height / 2]


@given(clouds, windows)
def test_all_points_are_in_the_free_part(points: np.ndarray, free: Free):
    points = points + np.arange(len(points))[:, None] * [0.3, 0.2, 0.0]
    seen = pinhole(points, aimed(points, free), free)
    assert (seen >= np.array([free.left, free.top]) - 2).all()
    assert (seen <= np.array([free.right, free.bottom]) + 2).all()


@given(clouds, windows)
def test_the_picture_fills_the_free_part_one_way_or_the_other(points: np.ndarray, free: Free):
    points = points + np.arange(len(points))[:, None] * [0.3, 0.2, 0.0]
    seen = pinhole(points, aimed(points, free), free)
    room = [free.right - free.left, free.bottom - free.top]
    assert (np.ptp(seen, axis=0) / room).max() > 0.97


def test_pixels_are_those_of_a_pinhole():
    points = np.random.default_rng(4).uniform(-8, 8, (20, 3)) * [1, 1, 0.2]
    free = Free(900.0, 700.0, 20.0, 30.0, 600.0, 500.0)
    camera = aimed(points, free)
    np.testing.assert_allclose(pixels(points, camera, free), pinhole(points, camera, free))
