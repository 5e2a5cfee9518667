"""The scene of a network that diverges: factor, fills, and marks at the edge of the map."""

from dataclasses import replace

import numpy as np
import pytest

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import SCENE_WIDTH
from concord.dashboard.scene.magnification import MAGNIFIED, followed_magnification
from concord.dashboard.scene.plane import Plane, arrows, edge_of, is_outside
from concord.dashboard.view import View
from concord.dashboard.window import PageServer
from concord.filters.gaussian import Gaussian
from tests.dashboard.runs import run_of

RUN = run_of("target-tracking", nodes=8, steps=30)
VIEW = View(magnify=1.0, ellipses="all")


def with_errors(frame: StepFrame, error_m: float, width_m: float, nodes: int = 8) -> StepFrame:
    """Return a frame in which the first nodes are wrong, and unsure, by so much."""
    error, width = frame.scores.error.copy(), frame.scores.width.copy()
    error[:nodes], width[:nodes] = error_m, width_m
    return frame._replace(scores=frame.scores._replace(error=error, width=width))


@pytest.mark.parametrize("reach_m", [0.1, 1.0, 8.0, 70.0, 900.0])
def test_the_factor_makes_the_middle_error_a_good_part_of_the_map(reach_m: float):
    frame = with_errors(RUN.frames[-1], reach_m, reach_m / 30)
    factor = followed_magnification(1.0, frame, RUN.stage.scale)
    drawn = factor * reach_m * RUN.stage.scale
    assert factor in MAGNIFIED
    if 1 < factor < max(MAGNIFIED):
        assert SCENE_WIDTH / 7 / 2.5 - 1e-9 <= drawn <= SCENE_WIDTH / 7 * 1.3 + 1e-9
    # Where it is, it stays.
    assert followed_magnification(factor, frame, RUN.stage.scale) == factor


def test_some_nodes_that_diverge_leave_the_factor_alone():
    now = followed_magnification(1.0, RUN.frames[-1], RUN.stage.scale)
    assert now > 1
    some = with_errors(RUN.frames[-1], 5000.0, 5000.0, nodes=3)
    assert followed_magnification(now, some, RUN.stage.scale) == now
    assert (
        followed_magnification(now, with_errors(RUN.frames[-1], 5e3, 5e3), RUN.stage.scale) == 1.0
    )


def test_a_small_change_of_the_errors_does_not_change_the_factor():
    for reach_m in np.geomspace(0.5, 200.0, 40):
        factor = followed_magnification(
            1.0, with_errors(RUN.frames[-1], reach_m, 0.0), RUN.stage.scale
        )
        near = with_errors(RUN.frames[-1], 1.2 * reach_m, 0.0)
        assert followed_magnification(factor, near, RUN.stage.scale) == factor


def test_arrows_lie_at_the_edge_and_point_to_what_is_outside():
    edge = edge_of(np.array([[-10.0, -5.0], [10.0, 5.0]]))
    points = np.array([[40.0, 0.0], [0.0, -90.0], [-30.0, 30.0], [1.0, 1.0], [np.nan, 0.0]])
    out = is_outside(points, edge)
    assert out.tolist() == [True, True, True, False, False]
    drawn = arrows(points[out], edge, 0.1).reshape(-1, 3, 2, 3)
    for (shaft, *_), point in zip(drawn, points[out], strict=True):
        tail, tip = shaft[:, :2]
        assert not is_outside(0.999 * tip[None], edge).any()
        assert is_outside(1.001 * tip[None], edge).all()
        way, wanted = tip - tail, point / np.linalg.norm(point)
        assert way / np.linalg.norm(way) == pytest.approx(wanted)


def test_an_ellipse_that_covers_the_map_is_an_outline_and_what_is_outside_is_marked():
    server = PageServer("127.0.0.1", 0).server
    try:
        plane = Plane(server.scene, RUN.stage)
        view = replace(VIEW, selected=2)
        plane.draw(view, RUN.frames[-1], [RUN.frames[-1]])()
        filled = (np.asarray(plane._fill.batched_scales)[:, 0] > 0.01).nonzero()[0].tolist()
        assert filled == [2, RUN.stage.nodes]
        assert not plane._outside.visible
        # Every belief is far away and wide.
        wide = 1e6 * np.eye(len(RUN.stage.state_names))
        belief = Gaussian(RUN.frames[-1].belief.mean + 4e3, np.tile(wide, (RUN.stage.nodes, 1, 1)))
        frame = RUN.frames[-1]._replace(
            belief=belief, fused=Gaussian(RUN.frames[-1].fused.mean + 4e3, wide)
        )
        plane.draw(view, frame, [frame])()
        assert (np.asarray(plane._fill.batched_scales)[:, 0] < 0.01).all()
        assert plane._outlines.visible
        assert plane._outside.visible
        assert len(plane._outside.points) == 3 * (RUN.stage.nodes + 1)
        assert plane._factor.text == "errors × 1"
        # Fit aims at all of them.
        assert plane.shown(view, frame)[:, 0].max() > SCENE_WIDTH
    finally:
        server.stop()
