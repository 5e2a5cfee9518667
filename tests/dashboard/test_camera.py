"""Where scenes are looked at from: all of them is seen, as large as panels allow."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from concord.dashboard.scene.camera import FIELD_OF_VIEW_RAD, Free, aimed

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
    assert (seen >= np.array([free.left, free.top]) - 1e-6).all()
    assert (seen <= np.array([free.right, free.bottom]) + 1e-6).all()


@given(clouds, windows)
# A high and narrow scene, which looks the more different the nearer one comes.
@example(
    np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 0]]), Free(600.0, 500.0, 20.0, 30.0, 600.0, 500.0)
)
def test_no_nearer_camera_sees_all(points: np.ndarray, free: Free):
    points = points + np.arange(len(points))[:, None] * [0.3, 0.2, 0.0]
    camera = aimed(points, free)
    seen = pinhole(points, camera, free)
    room = [free.right - free.left, free.bottom - free.top]
    ahead = np.subtract(camera.look_at, camera.position)
    depths = (points - np.array(camera.position)) @ (ahead / np.linalg.norm(ahead))
    touches = depths.min() <= 0.1 + 1e-9
    assert touches or (np.ptp(seen, axis=0) / room).max() > 1 - 1e-6
