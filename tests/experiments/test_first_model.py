"""`concord new --from-log`: a log of any kind becomes a folder that runs."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import concord as cc
from concord.experiments.first_model import first_model
from tests.experiments.command_support import concord, refused

ROOT = Path(__file__).resolve().parents[2]
STEP_S, STEPS = 0.05, 4000
DRIFT, NOISE = (0.1, 0.02), (0.2, 0.05)


def walk(seed: int) -> str:
    """A log of two series that are what the first model says."""
    generator = np.random.default_rng(seed)
    lines = ["time,speed [m/s],Tank level"]
    true = 10 + np.cumsum(np.array(DRIFT) * generator.standard_normal((STEPS, 2)), axis=0)
    read = true + np.array(NOISE) * generator.standard_normal((STEPS, 2))
    lines += [f"{k * STEP_S:.3f},{a!r},{b!r}" for k, (a, b) in enumerate(read.tolist())]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_a_random_walk_is_found(seed: int, tmp_path: Path):
    (tmp_path / "tank.csv").write_text(walk(seed))
    namespace: dict = {"__file__": str(tmp_path / "model.py")}
    texts = first_model(tmp_path / "tank.csv", tmp_path)
    (tmp_path / "columns.toml").write_text(texts["columns.toml"])
    exec(texts["model.py"], namespace)
    assert namespace["STEP_S"] == STEP_S
    # Moments of 4,000 differences: three standard errors are 7 and 18 %.
    np.testing.assert_allclose(namespace["NOISE"], NOISE, rtol=0.07)
    np.testing.assert_allclose(np.sqrt(namespace["PLANT"].Q), DRIFT, rtol=0.18)
    assert namespace["PLANT"].state_names == ("speed_m_s", "Tank_level")


@pytest.mark.parametrize("ending", ["nc", "mcap", "ulg"])
def test_each_kind_of_log_becomes_a_folder_that_runs(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    if ending != "nc":
        pytest.importorskip("mcap_ros2" if ending == "mcap" else "pyulog", reason="extra logs")
    example = runpy.run_path(str(ROOT / "examples" / "own_log.py"))
    (tmp_path / "log").mkdir()
    example["WRITERS"][ending](tmp_path / "log", example["signals"](1.0))
    monkeypatch.chdir(tmp_path)
    said = concord(capsys, "new", "model", "--from-log", f"log/drive.{ending}")
    assert said.out == (
        "model/ is written; next: concord run --scenario model/model.py:SCENARIO\n"
    ), said
    run = ("run", "--scenario", "model/model.py:SCENARIO", "--steps", "30", "--out", "run")
    assert concord(capsys, *run).code in (0, 1)
    assert (tmp_path / "run" / "run.nc").is_file()


def test_a_log_without_stamps_or_numbers_is_refused_and_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for text, cure in (
        ("speed\n1\n2\n3\n", "name the column of the stamps time"),
        ("time,gear\n0,R\n1,D\n", "'R', which is not a number"),
        ("", "no series of numbers"),
    ):
        Path("drive.csv").write_text(text)
        assert cure in refused(concord(capsys, "new", "model", "--from-log", "drive.csv"))
        assert not Path("model").exists()
    assert "gone.csv" in refused(concord(capsys, "new", "model", "--from-log", "gone.csv"))


def test_series_that_are_left_out_stand_in_the_columns(tmp_path: Path):
    names = [f"s{k}" for k in range(15)]
    rows = "".join(f"{k * 0.1:.1f}," + ",".join([f"{k % 4}.5"] * 15) + "\n" for k in range(9))
    (tmp_path / "many.csv").write_text("time," + ",".join(names) + "\n" + rows)
    columns = first_model(tmp_path / "many.csv", tmp_path)["columns.toml"]
    assert columns.count("column =") == 13 and "# s12: only 12 series are taken" in columns


def written(text: str, folder: Path, name: str = "drive.csv") -> dict:
    """The names that the model of a log defines; its folder holds the columns."""
    (folder / name).write_text(text)
    texts = first_model(folder / name, folder)
    (folder / "columns.toml").write_text(texts["columns.toml"])
    namespace: dict = {"__file__": str(folder / "model.py")}
    exec(texts["model.py"], namespace)
    return namespace


def rows(names: str, *columns: np.ndarray, stamp: str = "{:.1f}") -> str:
    lines = [f"time,{names}"]
    for k, values in enumerate(zip(*columns, strict=True)):
        lines.append(",".join([stamp.format(0.1 * k), *map(repr, map(float, values))]))
    return "\n".join(lines) + "\n"


def test_a_small_change_of_a_large_number_is_seen(tmp_path: Path):
    generator = np.random.default_rng(0)
    latitude = 48.12 + 1e-6 * generator.standard_normal(400)
    utm = 431234.5 + 0.02 * generator.standard_normal(400)
    model = written(rows("latitude,utm", latitude, utm), tmp_path)
    np.testing.assert_allclose(model["NOISE"], (1e-6, 0.02), rtol=0.2)
    np.testing.assert_array_equal(model["PLANT"].mean, (latitude[0], utm[0]))


@pytest.mark.parametrize("unit", ["km/h", "deg", "V"])
def test_noise_and_readings_have_the_unit_of_the_log(unit: str, tmp_path: Path):
    generator = np.random.default_rng(0)
    text = rows("speed", 36 + generator.standard_normal(200))
    text = text.replace("speed\n", f"speed\ns,{unit}\n", 1)
    model = written(text, tmp_path)
    readings = cc.simulate(model["SCENARIO"])["readings"].values
    assert np.nanmean(readings) == pytest.approx(36, abs=0.5)
    assert model["NOISE"][0] == pytest.approx(1, rel=0.3)


def test_odd_names_and_sentinels_still_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    values = 20 + 0.1 * np.sin(np.arange(60.0))
    values[9::20] = 65535
    text = rows('"driver\'s, own ""speed"""', values)
    model = written(text, tmp_path, 'it\'s a "log".csv')
    assert np.nanmax(cc.simulate(model["SCENARIO"])["readings"].values) < 21
    assert "65535 is taken for none" in capsys.readouterr().err
    with pytest.raises(ValueError, match="'v' is there twice"):
        written(rows("v,v", values, values), tmp_path)


def test_stamps_are_no_series_and_tell_their_unit(tmp_path: Path):
    times = ("time_gps", 0.1 * np.arange(30), {"units": "s"})
    data = xr.Dataset({"speed": ("time_gps", np.arange(30.0))}, coords={"time_gps": times})
    data.to_netcdf(tmp_path / "drive.nc", engine="h5netcdf")
    texts = first_model(tmp_path / "drive.nc", tmp_path)
    assert texts["columns.toml"].count("column =") == 1
    text = rows("v", np.arange(30.0)).replace("time,", "timestamp,", 1)
    lines = [text.splitlines()[0]]
    lines += [f"{1_780_000_000_000 + 100 * k},{k}" for k in range(30)]
    (tmp_path / "ms.csv").write_text("\n".join(lines))
    assert 'unit = "ms"' in first_model(tmp_path / "ms.csv", tmp_path)["columns.toml"]


def test_noise_of_a_smooth_motion_is_found(tmp_path: Path):
    """A gyroscope and an angle whose drift is no walk."""
    time = 0.05 * np.arange(600)
    noise, generator = np.array([0.02, 0.5]), np.random.default_rng(4)
    true = np.stack([0.3 * np.sin(time), 20 * np.cos(1.3 * time)], axis=-1)
    model = written(
        rows("gyro,angle", *(true + noise * generator.standard_normal(true.shape)).T), tmp_path
    )
    # The third differences of 600 readings: three standard errors are 25 %.
    np.testing.assert_allclose(model["NOISE"], noise, rtol=0.25)


def test_the_model_of_one_log_takes_another_log_of_the_same_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for name, seed in (("one.csv", 1), ("other.csv", 2)):
        Path(name).write_text("\n".join(walk(seed).splitlines()[:60]) + "\n")
    concord(capsys, "new", "tank", "--from-log", "one.csv")
    run = ("run", "--scenario", "./tank/model.py:SCENARIO", "--data", "other.csv", "--out", "run")
    assert concord(capsys, *run).code in (0, 1)
    with xr.open_dataset("run/run.nc", engine="h5netcdf") as kept:
        reads = kept["readings"].to_numpy()[0, :, 0, 0, 0]
    np.testing.assert_allclose(reads, np.loadtxt("other.csv", delimiter=",", skiprows=1)[:, 1])
    Path("strange.csv").write_text("time,a\n0,1\n1,2\n")
    said = refused(concord(capsys, *run[:3], "--data", "strange.csv"))
    assert "no column 'speed [m/s]'" in said and "there are time, a" in said
