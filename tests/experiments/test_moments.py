"""Moments of many runs: pieces in any order, and statistics against numpy."""

import numpy as np
import pytest

from concord.results.figures.intervals import positive_mean_t, ratio_t
from concord.studies.monte_carlo.moments import (
    PAIR_STATISTICS,
    QUANTILES,
    STATISTICS,
    apart,
    reduced,
    statistics_of,
)
from concord.studies.sweep.pieces import CellParts, Piece

RUNS, STEPS = 37, 3
NAMES = ("rmse", "rmse_centralised", "share_age", "error", "bound")
SHAPES = {"rmse": (), "rmse_centralised": (), "share_age": (), "error": (STEPS,), "bound": (STEPS,)}


def figures(runs: int, seed: int = 1) -> dict[str, np.ndarray]:
    drawn = np.random.default_rng(seed)
    rmse = np.exp(drawn.normal(size=runs))
    rmse[::7] = np.nan
    return {
        "rmse": rmse,
        "rmse_centralised": rmse * np.exp(0.01 * drawn.normal(size=runs)),
        "share_age": np.zeros(runs),
        "error": drawn.random((runs, STEPS)),
        "bound": np.array([3.0, 2.0, np.nan]),
    }


def piece(whole: dict[str, np.ndarray], runs: np.ndarray) -> dict[str, np.ndarray]:
    part = {name: values if name == "bound" else values[runs] for name, values in whole.items()}
    return reduced(part, NAMES)


def test_pieces_in_any_order_give_the_same_bits_and_in_any_grouping_the_same_statistics():
    whole, drawn = figures(RUNS), np.random.default_rng(2)
    expected = statistics_of(piece(whole, np.arange(RUNS)), SHAPES)
    for _ in range(5):
        cuts = np.sort(drawn.choice(np.arange(1, RUNS), 4, replace=False))
        pieces = [
            (Piece(0, b"", int(some[0]), int(some[-1]) + 1), piece(whole, some))
            for some in np.split(np.arange(RUNS), cuts)
        ]
        in_order, shuffled = CellParts(), CellParts()
        for one in pieces:
            in_order.add(*one)
        for place in drawn.permutation(len(pieces)):
            shuffled.add(*pieces[place])
        found = statistics_of(in_order.figures(), SHAPES)
        for name, values in statistics_of(shuffled.figures(), SHAPES).items():
            assert found[name].tobytes() == values.tobytes(), name
            np.testing.assert_allclose(values, expected[name], rtol=1e-10, err_msg=name)


def test_statistics_are_those_of_the_runs():
    whole = figures(RUNS)
    found = statistics_of(piece(whole, np.arange(RUNS)), SHAPES)
    known = whole["rmse"][~np.isnan(whole["rmse"])]
    rmse = dict(zip(STATISTICS, found["rmse"], strict=True))
    assert rmse["count"] == len(known)
    assert rmse["mean"] == pytest.approx(known.mean(), rel=1e-14)
    assert rmse["std"] == pytest.approx(known.std(ddof=1), rel=1e-12)
    assert rmse["rms"] == pytest.approx(np.sqrt((known**2).mean()), rel=1e-14)
    assert rmse["spread"] == pytest.approx((known**2).std(ddof=1) / (known**2).mean(), rel=1e-12)
    assert (rmse["least"], rmse["greatest"]) == (known.min(), known.max())
    np.testing.assert_allclose(found["error"][1], whole["error"].mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(found["bound"][3], whole["bound"], rtol=1e-14)
    # A figure that is 0 in every run has no spread, and its quantiles are 0.
    assert found["share_age"][1:].tolist() == [0.0] * (len(STATISTICS) - 1)


def test_quantiles_are_within_their_bins():
    values = np.exp(3 * np.random.default_rng(4).normal(size=5000))
    whole: dict[str, np.ndarray] = {"rmse": values, "rmse_centralised": values}
    found = statistics_of(reduced(whole, tuple(whole)), dict.fromkeys(whole, ()))
    exact = np.quantile(values, QUANTILES, method="inverted_cdf")
    np.testing.assert_allclose(found["rmse"][-len(QUANTILES) :], exact, rtol=1 / 128)


def test_pairs_keep_what_their_runs_share():
    whole = figures(RUNS)
    found = statistics_of(piece(whole, np.arange(RUNS)), SHAPES)["to_centralised"]
    pair = dict(zip(PAIR_STATISTICS, found, strict=True))
    squares, others = (np.square(whole[name]) for name in ("rmse", "rmse_centralised"))
    interval = ratio_t(squares, others)
    assert pair["ratio"] == pytest.approx(interval.value, rel=1e-14)
    known = ~np.isnan(squares)
    influence = squares[known] / squares[known].mean() - others[known] / others[known].mean()
    assert pair["spread"] == pytest.approx(influence.std(ddof=1) / 2, rel=1e-9)
    difference = (whole["rmse"] - whole["rmse_centralised"])[known]
    assert pair["difference"] == pytest.approx(difference.mean(), rel=1e-12)
    assert pair["difference_std"] == pytest.approx(difference.std(ddof=1), rel=1e-12)
    # Unpaired, the interval would be far wider.
    assert pair["spread"] < 0.1 * positive_mean_t(squares).high


def test_an_infinite_error_stays_infinite():
    whole = {"rmse": np.array([1.0, np.inf, 2.0]), "rmse_centralised": np.ones(3)}
    found = statistics_of(reduced(whole, tuple(whole)), dict.fromkeys(whole, ()))
    assert found["rmse"][:2].tolist() == [3.0, np.inf] and found["rmse"][6] == np.inf
    assert found["to_centralised"][0] == 2


def test_unknown_figures_have_no_statistics():
    whole: dict[str, np.ndarray] = dict.fromkeys(("rmse", "rmse_centralised"), np.full(4, np.nan))
    found = statistics_of(reduced(whole, tuple(whole)), dict.fromkeys(whole, ()))
    assert found["rmse"][0] == 0 and np.isnan(found["rmse"][1:]).all()


def test_figures_that_are_not_named_stay_run_by_run():
    moments, others = apart(reduced(figures(RUNS), ("error",)))
    assert others.keys() == set(NAMES) - {"error"} and moments
