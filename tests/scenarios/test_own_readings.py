"""Own plants with the readings of a log: one log in every form, and what a log does not hold."""

import runpy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import concord as cc
from concord.plants.own_plant import OwnPlant
from concord.plants.own_readings import replayed
from concord.plants.own_sensor import OwnSensor
from concord.plants.own_truth import sensors_of_nodes
from concord.results.figures.summary import summarise
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.definitions.own import own_scenario
from concord.scenarios.preparation import prepare
from concord.studies.monte_carlo.simulate import AGES, INNOVATIONS, READINGS, simulate
from tests.test_batched_agreement import check_agreement

ROOT = Path(__file__).resolve().parent.parent.parent
STEP_S = 0.1
MOVE = np.array([[1.0, STEP_S], [0.0, 0.98]])
CART = OwnPlant(
    f=lambda x: x @ MOVE.T, Q=[1e-5, 1e-2], mean=[0, 0], cov=[1, 1], time_step_s=STEP_S,
    state_names=("place", "speed"), state_units=("m", "m/s"),
)  # fmt: skip
GPS = partial(
    OwnSensor, h=lambda x: x[..., :1], R=0.04, name="gps", every_s=0.4, channels=(("x", "m"),)
)
ODOMETER = OwnSensor(h=lambda x: x[..., 1:], R=0.01, name="wheel", channels=(("v", "m/s"),))
SENSORS = [GPS(), ODOMETER, None]
OPTIONS = {"rule": "labelled", "record_number": "float64", "bus": "ideal"}
KEEP = (READINGS, AGES, INNOVATIONS)


def simulated() -> tuple[np.ndarray, np.ndarray]:
    """Readings (steps, 3, 1, 1) and truth (steps, 2) of a run of the same network."""
    setup = prepare(own_scenario(CART, SENSORS, steps=80).with_(**OPTIONS))
    trace = read_trace(setup, in_memory(setup))
    return trace.readings, trace.truth


READ, TRUTH = simulated()
TIMES_S = 100.0 + STEP_S * np.arange(len(TRUTH))


def dataset() -> xarray.Dataset:
    """The log in memory; a reading that was not taken is NaN."""
    return xarray.Dataset(
        {
            "gps.x": ("time", READ[:, 0, 0, 0]),
            "wheel_v": ("time", READ[:, 1, 0, 0]),
            "place": ("time", TRUTH[:, 0]),
            "speed": ("time", TRUTH[:, 1]),
        },
        {"time": ("time", TIMES_S, {"units": "s"})},
    )


def as_csv(folder: Path) -> Path:
    file = folder / "log.csv"
    rows = zip(TIMES_S, READ[:, 0, 0, 0], READ[:, 1, 0, 0], *TRUTH.T, strict=True)
    text = "time,gps x,wheel v,place,speed\n"
    for row in rows:
        text += ",".join("" if np.isnan(one) else repr(float(one)) for one in row) + "\n"
    file.write_text(text)
    return file


def as_folder(folder: Path) -> Path:
    """In other names and units, with a delay of the stamps."""
    rows = zip(
        1e3 * (TIMES_S + 0.05), READ[:, 0, 0, 0], 3.6 * READ[:, 1, 0, 0], *TRUTH.T, strict=True
    )
    text = "t,a,b,p,s\n"
    for row in rows:
        text += ",".join("" if np.isnan(one) else repr(float(one)) for one in row) + "\n"
    (folder / "drive.csv").write_text(text)
    (folder / "columns.toml").write_text(
        'time = { column = "t", unit = "ms", offset = -0.05 }\n[channels]\n'
        '"gps x" = { column = "a", unit = "m" }\n"wheel v" = { column = "b", unit = "km/h" }\n'
        '[truth]\nplace = { column = "p", unit = "m" }\nspeed = { column = "s", unit = "m/s" }\n'
    )
    return folder


def as_netcdf(folder: Path) -> Path:
    dataset().to_netcdf(folder / "log.nc", engine="h5netcdf")
    return folder / "log.nc"


SERIES = {
    "gps": READ[:, 0, 0, 0], "wheel": READ[:, 1, 0, 0], "place": TRUTH[:, 0], "speed": TRUTH[:, 1],
}  # fmt: skip


def mapped(folder: Path, file: str, column: str) -> Path:
    """Write the map of columns that are named after the series."""
    gps, wheel, place, speed = (column.format(name) for name in SERIES)
    (folder / "columns.toml").write_text(
        f'file = "{file}"\n[channels]\n"gps x" = {{ column = "{gps}", unit = "m" }}\n'
        f'"wheel v" = {{ column = "{wheel}", unit = "m/s" }}\n'
        f'[truth]\nplace = {{ column = "{place}", unit = "m" }}\n'
        f'speed = {{ column = "{speed}", unit = "m/s" }}\n'
    )
    return folder


def as_mcap(folder: Path) -> Path:
    """A topic of std_msgs/Float64 for each series; a reading that was not taken has no message."""
    Writer = pytest.importorskip("mcap_ros2.writer").Writer
    with (folder / "log.mcap").open("wb") as stream:
        writer = Writer(stream)
        number = writer.register_msgdef("std_msgs/msg/Float64", "float64 data")
        for name, values in SERIES.items():
            for time_s, value in zip(TIMES_S, values, strict=True):
                if np.isfinite(value):
                    stamp_ns = round(1e9 * time_s)
                    writer.write_message(f"/{name}", number, {"data": float(value)}, stamp_ns)
        writer.finish()
    return mapped(folder, "log.mcap", "/{}.data")


def as_ulog(folder: Path) -> Path:
    """A message for each series, stamped in microseconds."""
    pytest.importorskip("pyulog")
    write_ulog = runpy.run_path(str(ROOT / "examples" / "own_log.py"))["write_ulog"]
    known = {name: np.isfinite(values) for name, values in SERIES.items()}
    write_ulog(
        folder,
        {name: (TIMES_S[known[name]], SERIES[name][known[name]][:, None]) for name in SERIES},
    )
    return mapped(folder, "drive.ulg", "{}.value[0]")


FORMS = [lambda _: dataset(), as_csv, as_folder, as_netcdf, as_mcap, as_ulog]


@pytest.mark.parametrize("form", FORMS)
def test_a_log_gives_the_figures_of_the_run_that_it_was_written_from(form, tmp_path: Path):
    asked = own_scenario(CART, SENSORS, readings=form(tmp_path)).with_(**OPTIONS)
    assert asked.steps == len(TRUTH)
    setup = prepare(asked)
    trace = read_trace(setup, in_memory(setup))
    np.testing.assert_allclose(trace.readings, READ, rtol=1e-12)
    np.testing.assert_allclose(trace.truth, TRUTH, rtol=1e-12)
    live = prepare(own_scenario(CART, SENSORS, steps=len(TRUTH)).with_(**OPTIONS))
    expected = summarise(simulate(live, [0], keep=KEEP))
    found = summarise(simulate(setup, [0], keep=KEEP))
    for name in ("rmse", "anees", "rmse_centralised"):
        assert found.value(name) == pytest.approx(expected.value(name), rel=1e-9)


def test_the_drivers_agree_on_a_log_with_a_delayed_sensor():
    late = [GPS(delay_s=0.25), ODOMETER, None]
    check_agreement(own_scenario(CART, late, readings=dataset()).with_(**OPTIONS, window_steps=8))


def test_without_columns_of_the_truth_the_readings_are_judged():
    log = dataset().drop_vars(["place", "speed"])
    found = summarise(
        simulate(
            prepare(own_scenario(CART, SENSORS, readings=log).with_(**OPTIONS)), [0], keep=KEEP
        )
    )
    assert np.isnan(found.value("rmse"))
    assert found.verdict.cause == "consistent", found.verdict.said


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: own_scenario(CART, SENSORS, readings="nowhere.csv"), "nowhere.csv"),
        (lambda: own_scenario(CART, SENSORS, readings=dataset()[["place"]]), "none of gps x"),
        (lambda: own_scenario(CART, [GPS(), GPS()], readings=dataset()), "nodes 0 and 1 both have"),
        (lambda: own_scenario(CART, SENSORS, readings=dataset(), nodes=5), "of 3 nodes"),
        (lambda: prepare(own_scenario(CART, SENSORS, readings=dataset(), steps=81)), "80 steps"),
    ],
)  # fmt: skip
def test_a_log_that_does_not_fit_is_refused(make, says: str):
    with pytest.raises(ValueError, match=says):
        make()


UNITS_OF_36 = [
    ("km/h", "km/h", 36.0),
    ("m/s", "km/h", 129.6),
    ("km/h", "m/s", 10.0),
    ("deg", "deg", 36.0),
    ("deg", "rad", np.pi / 5),
    ("rad", "deg", 36 * 180 / np.pi),
    ("g", "g", 36.0),
    ("V", "V", 36.0),
    ("", "km/h", 36.0),
]


@pytest.mark.parametrize("form", ["csv", "data set"])
@pytest.mark.parametrize(("logged", "believed", "expected"), UNITS_OF_36)
def test_readings_come_in_the_unit_of_their_channel(
    form: str, logged: str, believed: str, expected: float, tmp_path: Path
):
    plant = cc.OwnPlant(f=lambda x: x, Q=[1.0], mean=[0.0], cov=[1.0], time_step_s=0.1)
    sensor = cc.OwnSensor(h=lambda x: x, R=1.0, name="gps", channels=(("v", believed),))
    source: object = tmp_path / "drive.csv"
    if form == "csv":
        rows = "".join(f"{0.1 * k:.1f},36\n" for k in range(5))
        units = f"s,{logged}\n" if logged else ""
        (tmp_path / "drive.csv").write_text(f"time,gps_v\n{units}{rows}")
    else:
        attributes = {"units": logged} if logged else {}
        source = xarray.Dataset(
            {"gps_v": ("time", np.full(5, 36.0), attributes)},
            coords={"time": ("time", 0.1 * np.arange(5), {"units": "s"})},
        )
    found = replayed(plant, sensors_of_nodes(plant, [sensor]), source)
    np.testing.assert_allclose(found.readings[:, 0, 0, 0], expected, rtol=1e-12)


@pytest.mark.parametrize(("logged", "believed"), [("m", "km/h"), ("mV", "V"), ("deg", "m")])
def test_a_unit_of_another_quantity_is_refused(logged: str, believed: str):
    plant = cc.OwnPlant(f=lambda x: x, Q=[1.0], mean=[0.0], cov=[1.0], time_step_s=0.1)
    sensor = cc.OwnSensor(h=lambda x: x, R=1.0, name="gps", channels=(("v", believed),))
    source = xarray.Dataset(
        {"gps_v": ("time", np.full(5, 36.0), {"units": logged})},
        coords={"time": ("time", 0.1 * np.arange(5), {"units": "s"})},
    )
    with pytest.raises(ValueError, match=f"has the unit {logged}"):
        replayed(plant, sensors_of_nodes(plant, [sensor]), source)


def test_a_true_sensor_of_a_node_without_one_is_refused():
    plant = cc.OwnPlant(f=lambda x: x, Q=[1.0], mean=[0.0], cov=[1.0])
    sensor = cc.OwnSensor(h=lambda x: x, R=1.0)
    truth = cc.Truth(sensors=[None, cc.TrueSensor(bias=50)])
    with pytest.raises(ValueError, match="node 1 has no sensor; give None for it"):
        cc.own_scenario(plant, [sensor, None], truth=truth)
    alone: Any = cc.TrueSensor(bias=1)
    with pytest.raises(ValueError, match="must be a list with an entry for each node"):
        cc.own_scenario(plant, [sensor, None], truth=cc.Truth(sensors=alone))


def test_wrong_arguments_are_told_in_a_sentence():
    plant = cc.OwnPlant(f=lambda x: x, Q=[1.0], mean=[0.0], cov=[1.0])
    sensor = cc.OwnSensor(h=lambda x: x, R=1.0)
    for wrong in ({}, 5, [1, 2], b"x"):
        with pytest.raises(ValueError, match=f"^readings of type {type(wrong).__name__}: must be"):
            cc.own_scenario(plant, [sensor], readings=wrong)
    with pytest.raises(ValueError, match="steps 0: must be at least 1"):
        cc.own_scenario(plant, [sensor], steps=0)


def test_a_unit_of_the_map_is_never_ignored(tmp_path: Path):
    """A channel without a unit would take degrees for what the model means."""
    bare = [OwnSensor(h=lambda x: x[..., :1], R=0.04, name="gps", channels=(("x", ""),))]
    with pytest.raises(ValueError, match=r"gives gps x in 'm', which has no unit in the scenario"):
        replayed(CART, sensors_of_nodes(CART, bare), as_folder(tmp_path))
