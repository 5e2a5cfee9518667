"""Sets that hold the truth for certain, as they are drawn: the real zonotope and no hull of it."""

import itertools
import re

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import ConvexHull, Delaunay

from concord.dashboard.panels.zoom import SIZE, zoom
from concord.dashboard.scene.geometry import zonotope_corners
from concord.dashboard.theme import DARK
from concord.experiments.other_runs import OtherRuns
from concord.nodes.messages import Estimate, decode
from tests.dashboard.runs import frames_of, run_of

RUN = run_of("liu2021-network", steps=30, rule="zonotope")
generator_sets = st.integers(2, 7).flatmap(
    lambda count: arrays(
        np.float64, (2, count), elements=st.floats(-3, 3).map(lambda x: round(x, 2))
    )
)


@given(generator_sets)
def test_corners_are_those_of_the_hull_of_all_signs(generators: np.ndarray):
    generators = np.concatenate([generators, 0.1 * np.eye(2)], axis=1)
    centre = np.array([0.7, -2.0])
    corners = zonotope_corners(centre, generators)
    signs = np.array(list(itertools.product((-1, 1), repeat=generators.shape[1])))
    hull = ConvexHull(centre + signs @ generators.T)
    # In order: the area by the shoelace formula is that of the hull, and no corner is outside.
    x, y = corners.T
    area = 0.5 * abs((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    assert area == pytest.approx(hull.volume)
    outside = hull.equations[:, :2] @ corners.T + hull.equations[:, 2:]
    assert outside.max() < 1e-9


def polygons(html: str) -> list[np.ndarray]:
    return [
        np.array([point.split(",") for point in found.split()], float)
        for found in re.findall(r'<polygon points="([^"]+)"', html)
    ]


def test_every_zonotope_is_drawn_and_holds_the_truth():
    for frame in RUN.frames:
        drawn = polygons(zoom(RUN.stage, DARK, frame, (0, 1), None))
        assert len(drawn) == RUN.stage.nodes
        for corners in drawn:
            # The truth is in the middle of the picture; pixels are rounded to a tenth.
            larger = corners.mean(0) + (corners - corners.mean(0)) * 1.02
            assert Delaunay(larger).find_simplex([SIZE / 2, SIZE / 2]) >= 0


def test_what_is_fused_of_sets_is_called_what_it_is_and_holds_the_truth():
    other = run_of("oscillator", nodes=4, steps=3)
    names = {
        run.stage.fused_name: zoom(run.stage, DARK, run.frames[-1], (0, 1), None)
        for run in (RUN, other)
    }
    assert list(names) == ["fused ellipsoids", "fused"]
    for name, picture in names.items():
        assert f"{name}<" in picture
    for frame in RUN.frames:
        off = frame.fused.mean - frame.truth
        assert off @ np.linalg.solve(frame.fused.cov, off) <= 1


def test_the_zonotope_is_smaller_than_the_ellipsoid_that_is_told_of_it():
    frame = RUN.frames[-1]
    for node, generators in enumerate(frame.zonotopes):
        assert generators is not None
        corners = zonotope_corners(np.zeros(2), generators[[0, 1]])
        shape = np.linalg.inv(frame.belief.cov[node][:2, :2])
        assert np.einsum("ki,ij,kj->k", corners, shape, corners).max() <= 1 + 1e-9


def test_other_rules_tell_of_no_zonotope():
    run = run_of("liu2021-network", steps=3, rule="ellipsoid")
    told = [data for topic, data in run.messages if topic.startswith("estimate/")]
    assert told
    assert all(b"generators" not in data for data in told)


def test_what_is_no_zonotope_of_these_states_is_not_drawn():
    def spoilt(topic: str, data: bytes) -> tuple[str, bytes]:
        if topic != "estimate/2":
            return topic, data
        said: Estimate = decode(topic, data)
        generators = [[1.0], [2.0, 3.0]]
        return topic, msgspec.json.encode(msgspec.structs.replace(said, generators=generators))

    frames = frames_of(RUN.stage, [spoilt(*message) for message in RUN.messages])
    assert frames
    for frame in frames:
        assert frame.zonotopes[2] is None
        assert frame.zonotopes[1] is not None


def test_of_sets_no_other_runs_are_told():
    others = OtherRuns(RUN.stage.setup, sparing=True)
    assert np.isnan(others(np.array([0.0, 0.5])).bound).all()
    others.close()
