"""The ADLUKF study: fair to all filters; what it must show, on a short drive and on the whole."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.model import linear_tyre
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.papers.adlukf.claims import claims
from concord.papers.adlukf.drives import Elsewhere
from concord.papers.adlukf.filters import CONTESTANTS
from concord.papers.adlukf.sections import in_words, per_state, with_interval
from concord.papers.adlukf.study import (
    CASES,
    CHANNELS,
    average_nees,
    build_study,
    costs,
    estimate,
    matched_study,
    quantities,
    ratio,
    score,
    small_angles,
)
from concord.results.figures.intervals import Interval
from tests.papers.support import every_claim_can_fail

pytestmark = pytest.mark.slow

STEPS = 250


def model_drive(amplitude: float = 0.04) -> Drive:
    """A drive of the single-track model itself: no error of the model, no library needed."""
    model = small_angles(BMW_320I, linear_tyre, 0.01, np.eye(3))
    steering = amplitude * np.sin(0.03 * np.arange(STEPS))
    states, accelerations = [np.array([0.0, 0.0, 20.0])], []
    for angle in steering:
        accelerations.append(model.accelerations(states[-1], np.array([angle, 0.0]))[0])
        states.append(model.transition(states[-1], np.array([angle, 0.0]), 0))
    yaw_rate, side_slip, speed = np.array(states[:-1]).T
    zeros = np.zeros(STEPS)
    wheels = np.repeat(speed[:, None], 4, axis=1)
    return Drive(
        0.01, steering, yaw_rate, side_slip, speed, zeros, np.array(accelerations), wheels, zeros
    )


def test_every_filter_sees_the_same_noise_and_cases_differ_as_they_say():
    cases = tuple(CASES.values())
    study = build_study((model_drive(), model_drive(0.02)), cases, 30, seed=3)
    assert study.measurements.shape == (STEPS, 2, len(cases), 30, 3)
    exact = np.stack([study.model.measure(s, u) for s, u in zip(
        model_drive().states, model_drive().inputs, strict=True)])  # fmt: skip
    error = study.measurements[:, 0] - exact[:, None, None]
    at = {case.name: number for number, case in enumerate(cases)}
    std = np.array([channel.std for channel in CHANNELS.values()])
    true = error[:, at["true R"]]
    np.testing.assert_allclose(true.std(axis=(0, 1)), std, rtol=0.03)
    for same in ("0.01 I", "2 I"):
        np.testing.assert_array_equal(error[:, at[same]], true)
    np.testing.assert_allclose(study.believed[0, at["2 I"]], np.full((30, 3), 2.0))
    assert np.isnan(study.measurements[:, :, at["a_y alone"], :, 1:]).all()
    wild = np.abs(error[:, at["outliers"]] - true) > 1e-9
    assert 0.015 < wild.mean() < 0.025


def test_scores_are_in_their_units():
    study = build_study((model_drive(),), (CASES["true R"],), 3, seed=1)
    off = np.broadcast_to(study.truth, study.measurements.shape) + np.array([0.01, 0.002, 0.3])
    scores = score(study, off)
    np.testing.assert_allclose(scores.mae[..., 0], 0.3)
    np.testing.assert_allclose(scores.rmse[..., 3], np.degrees(0.01))
    np.testing.assert_allclose(scores.mae[..., 2], np.degrees(0.002))
    np.testing.assert_allclose(scores.sd[..., [0, 2, 3]], 0.0, atol=1e-9)
    vy = quantities(np.array([0.0, 0.1, 20.0]))[1]
    assert vy == pytest.approx(20 * np.tan(0.1))


def test_lanes_of_the_study_are_runs_of_their_own():
    cases = (CASES["true R"], CASES["2 I"])
    together = build_study((model_drive(), model_drive(0.02)), cases, 4, seed=2)
    apart = build_study((model_drive(),), cases[1:], 2, seed=2)
    for contestant in CONTESTANTS.values():
        both = estimate(together, contestant).mean[:, 0, 1, :2]
        alone = estimate(apart, contestant).mean[:, 0, 0]
        np.testing.assert_allclose(both, alone, rtol=1e-6, atol=1e-8, err_msg=contestant.name)


def test_a_wrong_start_costs_the_ckf_more_than_the_adlukf():
    study = build_study((model_drive(),), tuple(CASES.values())[:3], 20, seed=4)
    results = {n: score(study, estimate(study, CONTESTANTS[n]).mean) for n in ("CKF", "ADLUKF")}
    assert ratio(results, "CKF", 0, "v_x").value > 1.3
    assert 0.7 < ratio(results, "ADLUKF", 0, "v_x").value < 1.3


def test_matched_data_tell_who_is_consistent():
    model = build_study((model_drive(),), (CASES["true R"],), 2, seed=1).model
    study = matched_study(model_drive(), model, 40, seed=5)
    nees = {n: average_nees(study, CONTESTANTS[n]) for n in ("UKF", "DLUKF", "DLUKF consistent")}
    assert nees["UKF"].shape == (40,)
    # 40 runs of some ten independent instants each: the deviation of the mean is about a tenth.
    assert nees["UKF"].mean() == pytest.approx(3.0, abs=0.4)
    assert nees["DLUKF consistent"].mean() == pytest.approx(nees["UKF"].mean(), abs=0.01)
    assert nees["DLUKF"].mean() > nees["UKF"].mean() + 0.5


def test_model_evaluations_are_those_of_the_equations():
    """Points: 2n of the CKF, 2n+1 = 7 else; an inner filter has both models on each of 7 points."""
    found = {n: c.evaluations for n, c in costs(matched()).items()}
    assert found["CKF"] == 12
    assert found["UKF"] == found["FAUKF"] == found["MCUKF"] == 14
    assert found["AUKF"] == 21
    assert found["DLUKF"] == found["DLUKF consistent"] == 7 * 14 + 7
    assert found["ADLUKF"] == found["ADLUKF printed"] == 7 * 14 + 7 + 7


def matched():
    long = model_drive()
    twice = Drive(0.01, *(np.concatenate([values, values]) for values in long[1:]))
    return build_study((twice,), (CASES["true R"],), 2, seed=1)


@pytest.mark.parametrize(
    ("half", "says"),
    [
        (0.0123, "5.438 ± 0.012"),
        (0.0223, "5.44 ± 0.02"),
        (3.4, "5 ± 4"),
        (10.0, "5.44 (0.86 to 34)"),
        (0.0, "5.44"),
    ],
)
def test_numbers_are_as_long_as_they_are_known(half: float, says: str):
    """Of the pair m - d, m + d the half width on the logarithm is 12.706 d / m (Student's t with
    one degree): 5.4377 sinh(3.4 / 5.4377) = 3.6, and 5.4377 exp(10 / 5.4377) = 34."""
    assert with_interval(5.4377 + half / 12.7062 * np.array([-1.0, 1.0])) == says


def test_a_cell_holds_both_manoeuvres():
    table = per_state({"UKF": np.array([[1, 2, 3], [4, 5, 6.0]])}, "RMSE")
    assert "RMSE (double lane change / serpentine) | v_x | side slip | yaw rate" in table
    assert "| UKF | 1.00 / 4.00 | 2.00 / 5.00 | 3.00 / 6.00 |" in table


def test_what_holds_elsewhere_is_counted():
    def drive(ours, reference, over):
        return Elsewhere(
            "car",
            {"ADLUKF": np.array(ours), "CKF": np.array(reference)},
            {"ADLUKF": np.array(over)},
        )

    words = in_words(
        [
            drive([0.8, 1.2], [3.0, 1.4], [0.9, 0.9]),
            drive([0.79, 1.0], [0.7, 2.0], [0.9, 1.1]),
            drive([1.0, 1.61], [2.0, 2.0], [1.2, 0.9]),
        ]
    )
    assert "In 3 drives" in words
    assert "0.79 to 1.61 (both within 0.8 and 1.2 in 1), the CKF's 0.70 to 3.00" in words
    assert words.endswith("beats the CKF in both states in 1.")


def _exactly(*values: float) -> tuple[Interval, ...]:
    return tuple(Interval(value, value, value) for value in values)


MEASURED = dict(
    adlukf_rmse=0.126, adlukf_mae=0.139, ckf_rmse=0.338, ckf_sd=0.0704, ckf_mae=0.311,
    yaw_error_deg_s=17.9, yaw_sd_deg_s=193.4,
    beaten={
        ("rmse", "yaw rate"): _exactly(0.02, -0.05, 0.02, 0.01),
        ("rmse", "side slip"): _exactly(-0.003, 0.001, 0.0, 0.0),
        ("mae", "v_x"): _exactly(0.002, 0.001, 0.002, 0.001),
    },
    mean={
        ("rmse", "yaw rate"): "", ("rmse", "side slip"): "", ("mae", "v_x"): "",
    },
    yaw_error=(0.14, 0.12), yaw_signal=(6.0, 10.0), yaw_spread=(9.1, 13.3),
    adlukf_ratio=_exactly(0.99, 0.99, 1.04, 0.96), ckf_ratio=_exactly(4.6, 1.6, 2.8, 1.35),
    ckf_side_slip_ratio=_exactly(0.93, 0.96), evaluations=9.3, seconds=4.0,
    printed_cost=1.01, ckf_lost=0, all_lost=0,
    printed_over_ckf=_exactly(4.7, 1.03, 4.4, 3.4, 1.02, 2.8),
)  # fmt: skip


def test_claims_get_the_verdicts_that_the_figures_say():
    verdicts = [claim.verdict for claim in claims(MEASURED)]
    assert verdicts == [
        "does not hold", "does not hold", "does not hold", "contradicts itself", "does not hold",
        "holds", "does not hold", "contradicts itself", "does not hold", "does not hold",
        "does not hold", "does not hold",
    ]  # fmt: skip


def test_every_claim_can_fail():
    every_claim_can_fail(claims, MEASURED)


def test_one_seed_is_refused(tmp_path: Path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["reproduce", "adlukf", "--runs", "1", "--out", str(tmp_path / "x")])
    assert ended.value.code == 2
    assert "at least 2" in capsys.readouterr().err


@pytest.mark.study
@pytest.mark.skipif(
    importlib.util.find_spec("vehiclemodels") is None, reason="needs the extra vehicle"
)
def test_the_whole_reproduction_holds(tmp_path: Path, capsys):
    folder = tmp_path / "adlukf"
    main(["reproduce", "adlukf", "--runs", "6", "--out", str(folder), "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["ok"]
    for name in ("figure-4.png", "figure-5.png", "figure-9.png"):
        assert (folder / name).stat().st_size > 50_000
    text = (folder / "report.md").read_text(encoding="utf-8")
    for words in ("does not win", "counts every reading twice", "Table 3", "CommonRoad", "Vanagon"):
        assert words in text
