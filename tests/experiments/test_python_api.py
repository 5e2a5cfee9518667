"""The public names: they load lazily, speak of keywords, and give the figures of the commands."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import concord as cc
from concord.entries import entries
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.studies.monte_carlo.simulate import simulate

SMALL = cc.scenario("oscillator", nodes=3, steps=25, graph="path")


def test_every_public_name_is_there_and_others_are_named():
    for name in entries("NAMES"):
        assert getattr(cc, name) is not None
        assert name in dir(cc)
    with pytest.raises(AttributeError, match=r"concord has no 'simulte'; it has .*simulate"):
        _ = cc.simulte  # type: ignore[attr-defined]


def test_importing_concord_loads_nothing_else():
    code = "import concord, sys; print({'numpy', 'scipy', 'xarray'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"grpah": "path"}, "unknown option 'grpah': did you mean 'graph'"),
        (
            {"window_steps": 8},
            "window_steps 8: belongs to rule labelled or labelled-ellipsoid; leave it out",
        ),
        ({"nodes": "8"}, "nodes 8: must be a whole number"),
        ({"hold": "drop", "decay": 0.3}, "decay 0.3: belongs to hold decayed"),
        ({"occupancy": 0.0}, r"occupancy 0.0: must be in"),
    ],
)
def test_messages_speak_of_keywords(options: dict, says: str):
    with pytest.raises(ValueError, match=says) as caught:
        cc.simulate(SMALL.with_(**options))
    assert "--" not in str(caught.value)
    with pytest.raises(ValueError, match=says):
        cc.simulate(cc.scenario("oscillator", **options))


def test_a_data_set_has_the_arrays_with_names_and_units():
    runs = cc.simulate(SMALL, runs=3, covariances=True)
    arrays = simulate(prepare(scenario_of("oscillator", nodes=3, steps=25, graph="path")), range(3))
    np.testing.assert_array_equal(runs["mean"], arrays.mean)
    assert dict(runs.sizes) | {"run": 3, "step": 25, "node": 3, "state": 2} == dict(runs.sizes)
    assert runs["state_unit"].values.tolist() == ["m", "m/s"]
    assert runs["cov"].dims == ("run", "step", "node", "state", "other_state")
    # Run r is the run of that number.
    alone = cc.simulate(SMALL.with_(run=2))
    np.testing.assert_allclose(alone["mean"].sel(run=2), runs["mean"].sel(run=2), rtol=1e-10)


def test_objects_of_a_session_are_swept_in_their_own_process_alone(tmp_path: Path):
    plant = cc.OwnPlant(f=lambda x: 0.9 * x, Q=1.0, mean=[0], cov=[1])
    own = cc.own_scenario(plant, [cc.OwnSensor(h=lambda x: x, R=1.0)], nodes=3, steps=30)
    assert cc.sweep(own, graph=["ring", "path"], runs=2)["rmse"].sizes == {"graph": 2, "run": 2}
    with pytest.raises(ValueError, match=r"at the top of a \.py file"):
        cc.sweep(own, graph=["ring", "path"], runs=2, workers=2)
    with pytest.raises(ValueError, match=r"at the top of a \.py file"):
        cc.sweep(own, graph=["ring", "path"], runs=2, out=tmp_path / "s.nc")


def test_no_run_is_refused():
    with pytest.raises(ValueError, match="runs 0: must be at least 1"):
        cc.simulate(SMALL, runs=0)
    with pytest.raises(ValueError, match="runs 0: must be at least 1"):
        cc.sweep(SMALL, runs=0)


@pytest.mark.zenoh
def test_a_launch_leaves_what_load_reads(tmp_path: Path):
    run = cc.launch(SMALL, out=tmp_path / "run")
    assert run.identical(cc.load(tmp_path / "run"))
    batched = cc.simulate(SMALL)["mean"].isel(run=0)
    np.testing.assert_allclose(run["mean"].isel(run=0), batched, rtol=1e-10, atol=1e-12)
    assert cc.agree(SMALL.with_(steps=10)) == ()
    with pytest.raises(ValueError, match="the folder exists"):
        cc.launch(SMALL, out=tmp_path / "run")
    with pytest.raises(ValueError, match="concord collect"):
        cc.load(tmp_path)
    (tmp_path / "run.nc").write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"run\.nc: cannot be read as netCDF"):
        cc.load(tmp_path)


def test_a_sweep_of_a_scenario_keeps_its_options_and_takes_arrays():
    base = SMALL.with_(rule="wac", rounds=2)
    swept = cc.sweep(base, occupancy=np.array([1.0, 0.5]), runs=2)
    named = cc.sweep("oscillator", nodes=3, steps=25, graph="path", rule="wac", rounds=2,
                     occupancy=[1.0, 0.5], runs=2)  # fmt: skip
    assert swept["rmse"].equals(named["rmse"])
    with pytest.raises(ValueError, match="takes a choice by its name"):
        cc.sweep(SMALL, rule=cc.rules.CovarianceIntersection(hold=cc.holds.Raw()))
