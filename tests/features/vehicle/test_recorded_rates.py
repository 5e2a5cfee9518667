"""One drive logged at four rates: every form of its files gives the same estimates.

Readings are counted where the nodes receive them and where their filters take them.
"""

import csv
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from concord.features.vehicle.plant.parameters import BMW_320I, car_to_toml
from concord.plants.recorded.channels import ChannelReadings
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from tests.experiments.support import scenario

pytestmark = pytest.mark.slow

UNITS = {
    "yaw_rate": "rad/s",
    "lateral_acceleration": "m/s2",
    "longitudinal_acceleration": "m/s2",
    "steering": "rad",
    "speed": "m/s",
    "front_left_wheel": "m/s",
    "front_right_wheel": "m/s",
    "side_slip": "rad",
}
# The BMW is driven at the rear, so that its front wheels are read; places of (node, channel).
PLACES = {
    "front_left_wheel": (0, 0),
    "front_right_wheel": (0, 1),
    "yaw_rate": (1, 0),
    "lateral_acceleration": (1, 1),
    "longitudinal_acceleration": (1, 2),
    "steering": (2, 0),
}
RATES_HZ = {"yaw_rate": 400, "lateral_acceleration": 400, "longitudinal_acceleration": 400}
RATES_HZ |= {"steering": 90, "speed": 20, "side_slip": 20}
STEPS = 300


def logged(seed: int = 1) -> dict[str, ChannelReadings]:
    """Readings of a gentle slalom at 20 m/s: inertial 400 Hz, steering 90, wheels 50, others 20."""
    generator = np.random.default_rng(seed)
    shapes = {"yaw_rate": 0.2, "lateral_acceleration": 4.0, "steering": 0.03, "side_slip": 0.01}
    channels = {}
    for name in UNITS:
        spacing_s = 1 / RATES_HZ.get(name, 50)
        times_s = np.arange(0.0, 1.6, spacing_s)
        jitter_s = generator.uniform(0, 0.3 * spacing_s, len(times_s))
        stamps_s = np.round(times_s + jitter_s, 7)
        values = shapes.get(name, 0.0) * np.sin(3 * stamps_s)
        if name == "speed" or name.endswith("wheel"):
            values = values + 20.0
        channels[name] = ChannelReadings(
            stamps_s, values + 1e-4 * generator.standard_normal(len(stamps_s))
        )
    return channels


def as_outer_join(folder: Path, channels: Mapping[str, ChannelReadings]) -> None:
    """Write one CSV file with a line for each stamp of any channel."""
    rows: dict[float, dict[str, float]] = {}
    for name, channel in channels.items():
        for stamp_s, value in zip(channel.stamps_s.tolist(), channel.values.tolist(), strict=True):
            rows.setdefault(stamp_s, {})[name] = value
    with (folder / "drive.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["t", *channels])
        writer.writeheader()
        writer.writerows({"t": stamp_s, **rows[stamp_s]} for stamp_s in sorted(rows))
    lines = [f'{name} = {{ column = "{name}", unit = "{UNITS[name]}" }}\n' for name in channels]
    (folder / "columns.toml").write_text('time = { column = "t", unit = "s" }\n' + "".join(lines))


def as_separate_files(folder: Path, channels: Mapping[str, ChannelReadings]) -> None:
    """Write a CSV file for each channel, its times in microseconds, its lines in any order."""
    lines = []
    for name, channel in channels.items():
        pairs = list(zip((channel.stamps_s * 1e6).tolist(), channel.values.tolist(), strict=True))
        np.random.default_rng(3).shuffle(pairs)
        with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([("stamp", "reading"), *pairs])
        lines.append(
            f'{name} = {{ column = "reading", unit = "{UNITS[name]}", file = "{name}.csv", '
            'time = { column = "stamp", unit = "us" } }\n'
        )
    (folder / "columns.toml").write_text("".join(lines))


def as_columns_of_pairs(folder: Path, channels: Mapping[str, ChannelReadings]) -> None:
    """Write one CSV file whose channels stand side by side, each beside its own times."""
    longest = max(len(channel.values) for channel in channels.values())
    columns = {}
    for name, channel in channels.items():
        empty = [""] * (longest - len(channel.values))
        columns[f"t {name}"] = [*channel.stamps_s.tolist(), *empty]
        columns[name] = [*channel.values.tolist(), *empty]
    with (folder / "pairs.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([columns, *zip(*columns.values(), strict=True)])
    lines = [
        f'{name} = {{ column = "{name}", unit = "{UNITS[name]}", '
        f'time = {{ column = "t {name}", unit = "s" }} }}\n'
        for name in channels
    ]
    (folder / "columns.toml").write_text('file = "pairs.csv"\n' + "".join(lines))


FORMS = (as_outer_join, as_separate_files, as_columns_of_pairs)


def trace_of(folder: Path, form=as_outer_join, **changes) -> Trace:
    folder.mkdir(parents=True)
    form(folder, logged())
    (folder / "car.toml").write_text(car_to_toml(BMW_320I))
    return read_trace(setup := setup_of(folder, **changes), in_memory(setup))


def setup_of(folder: Path, **changes) -> Setup:
    return prepare(scenario("vehicle-network", data=str(folder), steps=STEPS, **changes))


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> list[Trace]:
    return [trace_of(tmp_path_factory.mktemp("rates") / form.__name__, form) for form in FORMS]


def test_each_form_of_the_files_gives_the_same_estimates(traces: list[Trace]):
    first = traces[0]
    assert np.isfinite(first.mean).all()
    for other in traces[1:]:
        np.testing.assert_allclose(other.mean, first.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(other.cov, first.cov, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(np.isfinite(other.readings), np.isfinite(first.readings))


def test_every_reading_is_used_once(traces: list[Trace]):
    channels = logged()
    start_s = min(channel.stamps_s[0] for channel in channels.values())
    for trace in traces:
        for name, (node, place) in PLACES.items():
            stamps_s, values = channels[name]
            within = stamps_s < start_s + 0.005 * (STEPS - 0.5)
            used = trace.readings[:, node, :, place]
            used = used[np.isfinite(used)]
            assert len(used) == within.sum() > 0, name
            # Values have noise, so that no two are equal: none stands for another.
            assert len(set(used.tolist())) == len(used)
            np.testing.assert_allclose(np.sort(used), np.sort(values[within]), rtol=1e-12)
        assert np.isnan(trace.readings[:, 3]).all()


def test_the_filters_take_each_reading_once(tmp_path: Path):
    """Each innovation is that of one reading."""
    trace = trace_of(tmp_path / "log")
    found = runs_of_trace(setup_of(tmp_path / "log"), trace).innovations
    assert found is not None
    taken = np.isfinite(found.value[0]).sum(axis=(0, 2, 3))
    np.testing.assert_array_equal(taken, np.isfinite(trace.readings).sum(axis=(0, 2, 3)))
    assert taken.tolist()[2] == round(90 * 0.005 * STEPS) and taken[3] == 0


def test_a_fast_channel_loses_no_reading(traces: list[Trace]):
    """At 400 Hz two or three fall into a step of 5 ms; the last one alone was used once."""
    count = np.isfinite(traces[0].readings[:, 1, :, 0]).sum(axis=1)
    assert count.max() == 3 and 1.9 < count.mean() < 2.1


def test_more_readings_make_a_surer_estimate(traces: list[Trace], tmp_path: Path):
    """A gyroscope at 400 Hz is worth twice one at 200 Hz, where the process noise is small."""
    channels = logged()
    half = {
        name: ChannelReadings(channel.stamps_s[::2], channel.values[::2])
        if name == "yaw_rate"
        else channel
        for name, channel in channels.items()
    }
    as_outer_join(tmp_path, half)
    (tmp_path / "car.toml").write_text(car_to_toml(BMW_320I))
    prepared = setup_of(tmp_path, filter="ukf")
    fewer = read_trace(prepared, in_memory(prepared))
    more = trace_of(tmp_path / "more", filter="ukf")
    ratio = math.sqrt(fewer.cov[-1, 1, 0, 0] / more.cov[-1, 1, 0, 0])
    assert 1.02 < ratio < math.sqrt(2.0)


def test_labelled_sends_each_reading_once_as_well(tmp_path: Path):
    trace = trace_of(tmp_path / "log", rule="labelled", filter="ukf", cluster="fitted")
    assert np.isfinite(trace.mean).all()
