"""Targets and limits of a design: their forms, their edges, and what a candidate breaks."""

import numpy as np
import pytest

from concord.studies.design.target import BusLimits, DesignTarget, error_of, parse_target


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("8", DesignTarget(8.0, "unit")),
        ("0.5", DesignTarget(0.5, "unit")),
        ("1x-bound", DesignTarget(1.0, "bound")),
        ("1.5x-centralised", DesignTarget(1.5, "centralised")),
    ],
)
def test_a_target_is_a_number_or_a_multiple(text: str, target: DesignTarget):
    assert parse_target(text) == target


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("0.99x-centralised", "no network is better"),
        ("2x-centralized", "did you mean 'centralised'"),
        ("0", "positive number"),
        ("much", "positive number"),
        ("-3", "positive number"),
        ("nan", "positive number"),
        ("nanx-bound", "positive number"),
        ("x-bound", "positive number"),
    ],
)
def test_other_targets_are_refused(text: str, why: str):
    with pytest.raises(ValueError, match=why):
        parse_target(text)


def test_limits_that_no_network_meets_are_refused():
    for sound in (BusLimits(), BusLimits(1e-6, 1.0), BusLimits(load=1e-6)):
        sound.check()
    for latency_ms, load, why in (
        (0.0, None, "--latency-ms 0: must be above 0"),
        (-1.0, 0.5, "--latency-ms -1: must be above 0"),
        (None, 0.0, r"--load 0: must be in \(0, 1\]"),
        (None, 1.5, r"--load 1.5: must be in \(0, 1\]"),
    ):
        with pytest.raises(ValueError, match=why):
            BusLimits(latency_ms, load).check()


def test_a_candidate_breaks_a_limit_beyond_it_on_the_mean_of_its_runs():
    figures = {"delay_us": np.array([1000.0, 3000.0]), "bus_load": np.array([0.2, 0.4])}
    assert BusLimits(2.0, 0.3 + 1e-12).excess(figures) is None
    assert BusLimits(1.99, 0.5).excess(figures) == "--latency-ms 1.99: it has 2"
    assert BusLimits(None, 0.25).excess(figures) == "--load 0.25: it has 0.3"
    timeless = figures | {"delay_us": np.full(2, np.nan)}
    assert BusLimits(2.0).excess(timeless) == "--latency-ms 2: a bus without time has none"


def test_an_error_is_a_ratio_of_root_mean_squares_over_all_runs():
    rng = np.random.default_rng(1)
    names = ("rmse", "rmse_centralised", "bound_mean")
    figures = {name: rng.uniform(1, 2, 40) * scale for scale, name in enumerate(names, 1)}
    mean_square = {name: np.mean(values**2) for name, values in figures.items()}
    for reference, below in (
        ("unit", 1.0),
        ("centralised", mean_square["rmse_centralised"]),
        ("bound", mean_square["bound_mean"]),
    ):
        found = error_of(DesignTarget(1.0, reference), figures, 0.9)  # type: ignore[arg-type]
        assert found.value == pytest.approx(np.sqrt(mean_square["rmse"] / below))
        wider = error_of(DesignTarget(1.0, reference), figures, 0.99)  # type: ignore[arg-type]
        assert wider.low < found.low < found.value < found.high < wider.high
