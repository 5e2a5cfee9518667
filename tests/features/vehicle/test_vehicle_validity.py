"""Where the single-track model holds: each reason alone, and none on an ordinary drive."""

import numpy as np

from concord.features.vehicle.plant.model import single_track, tanh_tyre
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.features.vehicle.plant.validity import outside_model

TRACK = single_track(BMW_320I, tanh_tyre, 0.005)


def state(yaw_rate=0.0, side_slip=0.0, speed=20.0, steering=0.0):
    return np.array([yaw_rate, side_slip, speed, 0.0, steering, 0.0])


def reasons(*states) -> list[list[str]]:
    found = outside_model(TRACK, np.array(states))
    return [[name for name, mask in found.items() if mask[k]] for k in range(len(states))]


def test_each_reason_is_found_alone():
    straight, slow, steered, sideways, fast = reasons(
        state(),
        state(speed=2.9),
        state(speed=5.0, steering=0.2),
        state(side_slip=-0.2, steering=-0.2),
        # 0.8 of a friction of 1.05 are 8.2 m/s²; slips are 0.06 rad.
        state(yaw_rate=0.45, side_slip=-0.03, steering=0.05),
    )
    assert straight == []
    assert [name.split(" ")[0] for name in (*slow, *steered, *fast)] == ["below", "slip", "lateral"]
    # The front axle rolls where it points; the rear axle slides.
    assert [name.split(" ")[0] for name in sideways] == ["slip"]


def test_the_edge_is_where_it_is_said():
    """A slip of the front axle alone, in a car that goes straight."""
    below, above = reasons(state(steering=0.1199), state(steering=0.1201))
    assert below == []
    assert above == ["slip of an axle above 0.12 rad"]


def test_leading_axes_are_free():
    many = np.broadcast_to(state(speed=1.0), (4, 3, 6))
    assert all(mask.shape == (4, 3) for mask in outside_model(TRACK, many).values())
