"""Tracking on recorded robots: a recording made by hand, and the facts of the real set 6."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from concord.experiments.other_runs import told_by
from concord.features.recorded.confined_motion import ConfinedMotion
from concord.features.recorded.mrclam import recorded_target
from concord.features.recorded.mrclam_files import read_recording
from concord.features.recorded.sighting import Sighting
from concord.nodes.rules.labelled.record_codec import record_codec
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario, summary_of

SET_6 = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "mrclam6"

real_data = pytest.mark.skipif(
    not SET_6.is_dir(), reason="no ../shared/data/mrclam6 beside the checkout: real data not tested"
)


# --- robot 3 drives along x at 0.1 m/s. Their clocks start apart, so t0 = 100.1 s, t1 = 104.0 s.

BEGIN = {1: 100.0, 2: 100.05, 3: 100.1}


def pose_at(robot, time):
    return {1: (1.0, 0.0, math.pi / 2), 2: (0.0, 0.0, 0.0), 3: (0.1 * (time - 100), 2.0, 0.0)}[
        robot
    ]


def write_recording(folder, sightings, skip=lambda robot, time: False):
    """`sightings`: {robot: [(stamp, barcode, range, bearing)]}; ground truth at 20 Hz."""
    head = "# Time [s]  ...\n"
    (folder / "Barcodes.dat").write_text(head + "1 \t 5\n2 \t 14\n3 \t 41\n 6 \t 72\n")
    (folder / "Landmark_Groundtruth.dat").write_text(head + "6 0.5 -4.2 0.0001 0.0002\n")
    for robot, begin in BEGIN.items():
        times = [t for t in np.arange(begin, 104.001, 0.05) if not skip(robot, t)]
        rows = ["{:.3f} {} {} {}\n".format(time, *pose_at(robot, time)) for time in times]
        (folder / f"Robot{robot}_Groundtruth.dat").write_text(head + "".join(rows))
        seen = "".join("{:.3f} {} {} {}\n".format(*row) for row in sightings.get(robot, []))
        (folder / f"Robot{robot}_Measurement.dat").write_text(head + seen)
        (folder / f"Robot{robot}_Odometry.dat").write_text(head + "100.0 0.1 0.0\n")
    return folder


def sighted(plant):
    """Whether a node saw the target: (steps, nodes)."""
    return np.isfinite(plant.delivered[..., 0]).any(axis=-1)


def test_a_reading_belongs_to_the_first_instant_after_its_picture(tmp_path):
    """t_k = 100.1 + 0.2 k, pictures 45 ms before their stamps."""
    sightings = {
        2: [
            (100.140, 41, 9.0, 0.0),  # picture at 100.095, before t0: out
            (100.150, 41, 1.0, 0.0),  # 100.105 -> k = 1
            (100.345, 41, 2.0, 0.0),  # 100.300 -> k = 1 exactly, the instant itself
            (100.350, 41, 3.0, 0.0),  # 100.305 -> k = 2
            (100.350, 14, 8.0, 0.0),  # another robot: out
            (100.350, 99, 8.0, 0.0),  # a barcode without an owner: out
            (104.045, 41, 4.0, 0.0),  # 104.000, after t_19 = 103.9: out
            (103.900, 41, 5.0, 0.0),  # 103.855 -> k = 19
        ],
        1: [(103.5, 41, 6.0, 0.1)],  # 103.455 -> k = 17
    }
    plant = recorded_target(read_recording(write_recording(tmp_path, sightings)), 3)
    assert (plant.robots, plant.nodes, plant.steps) == ((1, 2), 2, 20)
    assert plant.delivered.shape == (20, 2, 2, 5)
    where = {
        (int(k), int(node)): plant.delivered[k, node, :, 0].tolist()
        for k, node in np.argwhere(sighted(plant))
    }
    assert where[1, 1] == [1.0, 2.0]  # in time order
    assert where[2, 1][0] == 3.0 and where[19, 1][0] == 5.0 and where[17, 0][0] == 6.0
    assert len(where) == 4
    np.testing.assert_allclose(plant.delivered[17, 0, 0], [6.0, 0.1, 1.0, 0.0, math.pi / 2])


def test_the_observer_is_where_it_was_at_the_picture(tmp_path):
    """Robot 3 moves: between two samples of ground truth its place is interpolated."""
    folder = write_recording(tmp_path, {3: [(102.117, 14, 2.0, -1.0)]})
    plant = recorded_target(read_recording(folder), 2)
    k, node = np.argwhere(sighted(plant))[0]
    assert plant.robots[node] == 3
    assert plant.delivered[k, node, 0, 2] == pytest.approx(0.1 * (102.117 - 0.045 - 100), abs=1e-9)
    np.testing.assert_allclose(plant.positions(k)[node, 0], 0.1 * (0.1 + 0.2 * k), atol=1e-9)


def test_a_heading_is_interpolated_across_the_half_turn(tmp_path):
    """From 3.1 rad to -3.1 rad in 0.1 s: half way it is pi, not 0."""
    folder = write_recording(tmp_path, {2: [(101.095, 41, 1.0, 0.0)]})
    times = [100.0 + 0.1 * tenth for tenth in range(41)]
    rows = [f"{time:.1f} 0 0 {3.1 if time < 101.05 else -3.1}\n" for time in times]
    (folder / "Robot2_Groundtruth.dat").write_text("".join(rows))
    plant = recorded_target(read_recording(folder), 3)
    heading = plant.delivered[sighted(plant)][0, 0, 4]
    assert math.cos(heading) == pytest.approx(-1.0)


def test_gaps_of_half_a_second_are_not_bridged(tmp_path):
    """The target, robot 3, is lost for 0.6 s; a node, robot 2, for 0.4 s and later for 0.6 s."""

    def skip(robot, time):
        lost = {3: [(101.0, 101.58)], 2: [(101.0, 101.33), (102.51, 103.08)]}
        return any(begin < time < end for begin, end in lost.get(robot, []))

    sightings = {2: [(101.245, 41, 2.0, 0.0), (102.845, 41, 2.0, 0.0)]}
    plant = recorded_target(read_recording(write_recording(tmp_path, sightings, skip)), 3)
    assert np.argwhere(sighted(plant)).tolist() == [[6, 1]]
    lost = np.isnan(plant.truth[:, 0])
    times = 100.1 + 0.2 * np.arange(20)
    assert (lost == ((times > 101.0) & (times < 101.6))).all()
    np.testing.assert_allclose(plant.truth[~lost, 0], 0.1 * (times[~lost] - 100), atol=1e-9)


def test_the_plant_replays_and_ends_in_missing_truth(tmp_path):
    folder = write_recording(tmp_path, {2: [(100.150, 41, 1.0, 0.2)]})
    plant = recorded_target(read_recording(folder), 3)
    draws = plant.draw(lambda purpose, node: np.random.default_rng(), plant.steps)
    assert draws.measurement.shape == (20, 2, 1, 5) and draws.process.shape == (20, 0)
    state, mean, cov = plant.initial(np.broadcast_to(draws.initial, (3, 0)))
    assert state.shape == mean.shape == (3, 4) and cov.shape == (4, 4)
    for step in range(plant.steps):
        np.testing.assert_array_equal(state, np.broadcast_to(plant.truth[step], (3, 4)))
        noise = np.broadcast_to(draws.measurement[step], (3, 2, 1, 5))
        assert plant.observe(state, noise, step).shape == (3, 2, 1, 5)
        state = plant.advance(state, None, np.empty((3, 0)), step)
    assert np.isnan(state).all()
    np.testing.assert_allclose(plant.truth[:, 2:], [[0.1, 0.0]] * 20, atol=1e-9)
    with pytest.raises(ValueError, match=r"21 steps, but .* has 20 of 0\.2 s; ask for 20"):
        plant.draw(lambda purpose, node: np.random.default_rng(), 21)


def test_an_unseen_target_is_a_plant_without_readings(tmp_path):
    plant = recorded_target(read_recording(write_recording(tmp_path, {})), 1)
    assert plant.delivered.shape == (20, 2, 1, 5)
    assert not sighted(plant).any()


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("Barcodes.dat", None, r"Barcodes\.dat: no such file; .*fetch"),
        ("Robot2_Measurement.dat", None, r"Robot2_Measurement\.dat: no such file"),
        (
            "Robot2_Odometry.dat",
            "# h\n1 2 3\n4 5\n",
            r"Odometry\.dat:3: 2 numbers, but a row has 3",
        ),
        ("Robot2_Odometry.dat", "# h\n1 2\n4 5\n", r"Odometry\.dat:2: 2 numbers, but a row has 3"),
        ("Robot1_Groundtruth.dat", "# h\n\n1 2 3 x\n", r"truth\.dat:3: 'x' is not a finite number"),
        ("Robot1_Groundtruth.dat", "1 2 3 nan\n2 3 4 5\n", r"truth\.dat:1: 'nan' is not a finite"),
        ("Robot1_Groundtruth.dat", "1 2 3 4\n", r"truth\.dat: 1 rows, but 2 are needed"),
        (
            "Robot1_Groundtruth.dat",
            "2 2 3 4\n1 2 3 4\n",
            r"1\.000 s does not follow 2\.000 s; sort",
        ),
        ("Robot1_Groundtruth.dat", "\x00\x01\n", r"truth\.dat:1: 1 numbers"),
        ("Landmark_Groundtruth.dat", "6 1 1\n", r"Landmark_Groundtruth\.dat:1: 3 numbers.* has 5"),
    ],
)
def test_a_damaged_recording_is_refused_by_file_and_line(tmp_path, file, text, message):
    write_recording(tmp_path, {})
    if text is None:
        (tmp_path / file).unlink()
    else:
        (tmp_path / file).write_text(text)
    with pytest.raises(ValueError, match=message):
        read_recording(tmp_path)


def test_what_is_no_recording_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no such folder; give the folder"):
        read_recording(tmp_path / "absent")
    with pytest.raises(ValueError, match=r"no Robot1_Groundtruth\.dat"):
        read_recording(tmp_path)


def test_a_target_must_be_on_record_marked_and_seen_by_others(tmp_path):
    recording = read_recording(write_recording(tmp_path, {}))
    with pytest.raises(ValueError, match="no robot 7 to track; choose one of the robots 1, 2, 3"):
        recorded_target(recording, 7)
    del recording.barcodes[2]
    with pytest.raises(ValueError, match="no barcode of robot 2; add its row"):
        recorded_target(recording, 2)
    del recording.robots[1], recording.robots[2]
    with pytest.raises(ValueError, match="robot 3 is alone"):
        recorded_target(recording, 3)


def test_recordings_of_different_days_are_refused(tmp_path):
    write_recording(tmp_path, {})
    (tmp_path / "Robot1_Groundtruth.dat").write_text("900 0 0 0\n901 0 0 0\n")
    with pytest.raises(
        ValueError, match=r"less than one step of 0\.2 s; use files of one recording"
    ):
        recorded_target(read_recording(tmp_path), 3)


# --- The sensor and the model.


def test_a_sighting_becomes_the_position_it_points_at():
    """Observer at (1, 2) facing +y, target 3 m ahead and 0.5 rad to the left."""
    reading = np.array([3.031, 0.5, 1.0, 2.0, math.pi / 2])
    value, cov = Sighting().interpret(reading)
    there = (1 + 3 * math.cos(math.pi / 2 + 0.5), 2 + 3 * math.sin(math.pi / 2 + 0.5))
    np.testing.assert_allclose(value, there, atol=1e-12)
    along = (value - [1.0, 2.0]) / 3
    np.testing.assert_allclose(cov @ along, (0.1**2 + 0.3**2) * along, atol=1e-12)
    across = np.array([-along[1], along[0]])
    np.testing.assert_allclose(cov @ across, 0.06**2 * across, atol=1e-12)


@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 4, 3)])
def test_interpretation_broadcasts_and_keeps_missing_apart(batch):
    rng = np.random.default_rng(3)
    delivered = rng.uniform(0.5, 3.0, (*batch, 5))
    missing = rng.uniform(size=batch) < 0.5
    delivered[missing] = np.nan
    value, cov = Sighting().interpret(delivered)
    assert value.shape == (*batch, 2) and cov.shape == (*batch, 2, 2)
    assert (np.isnan(value).all(axis=-1) == missing).all()
    assert np.isfinite(cov).all() and (np.linalg.eigvalsh(cov) > 0).all()
    for place in np.argwhere(~missing):
        alone_value, alone_cov = Sighting().interpret(delivered[tuple(place)])
        np.testing.assert_array_equal(alone_value, value[tuple(place)])
        np.testing.assert_array_equal(alone_cov, cov[tuple(place)])


def test_confined_motion_is_its_differential_equation():
    """Against a matrix exponential (Van Loan 1978), which also integrates the noise."""
    model = ConfinedMotion()
    for axis, frequency in enumerate(model.frequency_rad_s):
        drift = np.array([[0, 1], [-(frequency**2), -1 / 30]])
        density = np.diag([0, 2 * 0.042**2 / 30])
        block = expm(0.2 * np.block([[-drift, density], [np.zeros((2, 2)), drift.T]]))
        pair = np.ix_([axis, axis + 2], [axis, axis + 2])
        transition = block[2:, 2:].T
        np.testing.assert_allclose(model.transition_matrix[pair], transition, rtol=1e-12)
        noise = transition @ block[:2, 2:]
        np.testing.assert_allclose(model.process_noise_cov(0)[pair], noise, rtol=1e-7)


def test_confined_motion_has_its_stationary_law():
    model = ConfinedMotion()
    matrix, cov = model.transition_matrix, model.stationary_cov
    after = matrix @ cov @ matrix.T + model.process_noise_cov(0)
    np.testing.assert_allclose(after, cov, rtol=1e-14, atol=1e-18)
    expected = [(0.042 / 0.045) ** 2, (0.042 / 0.022) ** 2, 0.042**2, 0.042**2]
    np.testing.assert_allclose(cov, np.diag(expected))
    mean = model.stationary_mean
    np.testing.assert_allclose(model.transition(mean, None, 0), mean, rtol=1e-15)
    np.testing.assert_allclose(mean, [2.2, 0.2, 0, 0])


@pytest.mark.parametrize("batch", [(), (5,), (9, 2, 3)])
def test_confined_motion_moves_every_state_alike_and_keeps_the_layout(batch):
    model = ConfinedMotion()
    states = np.moveaxis(np.random.default_rng(1).normal(size=(4, *batch)), 0, -1)
    after = model.transition(states, None, 0)
    expected = (states - model.stationary_mean) @ model.transition_matrix.T + model.stationary_mean
    np.testing.assert_allclose(after, expected, atol=1e-14)
    assert after.strides == states.strides


def test_damping_that_prevents_an_oscillation_is_refused():
    with pytest.raises(ValueError, match="damping_1_s is 1, but must be below twice"):
        ConfinedMotion(velocity_time_constant_s=1.0)


# --- The real set 6: ../shared/spec/mrclam.md.

TARGETS = (1, 2, 3, 4, 5)


@pytest.fixture(scope="module")
def recording():
    return read_recording(SET_6)


@pytest.fixture(scope="module")
def plants(recording):
    return {target: recorded_target(recording, target) for target in TARGETS}


@real_data
def test_set_6_has_its_published_counts(recording, plants):
    sightings = [
        sum(
            int((robot.measurements[:, 1] == recording.barcodes[target]).sum())
            for number, robot in recording.robots.items()
            if number != target
        )
        for target in TARGETS
    ]
    assert sightings == [1074, 881, 416, 843, 774]
    readings = [np.isfinite(plants[target].delivered[..., 0]) for target in TARGETS]
    assert [int(found.sum()) for found in readings] == [992, 859, 407, 727, 745]
    assert max(int(found.sum(axis=(1, 2)).max()) for found in readings) == 3
    assert {plant.steps - 1 for plant in plants.values()} == {3859}
    assert plants[3].robots == (1, 2, 4, 5)
    assert len(recording.landmarks) == 15


@real_data
def test_set_6_shows_its_published_traps(recording, plants):
    truth = recording.robots[1].truth
    assert truth[-1, 0] - truth[0, 0] == pytest.approx(771.9, abs=0.05)
    lost = np.flatnonzero(np.isnan(plants[4].truth[:, 0])) * 0.2
    hole = lost[lost > 600]
    assert (hole[0], hole[-1]) == pytest.approx((696.0, 697.8))  # 2.03 s from 695.9 s
    assert not any(np.isnan(plants[target].truth[:, 0]).any() for target in (1, 2, 3, 5))
    for plant in plants.values():
        begin = np.flatnonzero(sighted(plant).any(axis=1))[0] * plant.time_step_s
        assert 7 <= begin <= 34
        assert np.nanmax(np.abs(np.diff(plant.truth[:, :2], axis=0))) < 0.3 * plant.time_step_s


def test_readings_that_mean_something_together_are_not_quantised():
    codec = record_codec(Sighting(), (1, 5), "<i2")
    assert codec is not None and codec.number == "<f4" and codec.rounding_cov is None
    assert record_codec(None, (1, 5), "<i2") is None


def test_errors_near_a_sighting_count_the_steps_after_it(mrclam_folder: Path):
    """Within 2 s, 10 steps, of a reading by any node."""
    asked = scenario("mrclam", data=str(mrclam_folder), target=4, steps=400)
    setup = prepare(asked)
    trace = read_trace(setup, in_memory(setup))
    figures = summary_of(setup, trace)
    seen = [k for k in range(400) if not np.isnan(trace.readings[k]).all()]
    near = [k for k in range(400) if any(k - 10 <= s <= k for s in seen) and k >= seen[0]]
    assert 0 < len(near) < 400
    for node in range(4):
        squares = ((trace.mean[near, node, :2] - trace.truth[near, :2]) ** 2).sum(1)
        expected = np.sqrt(squares[~np.isnan(squares)].mean())
        assert figures.nodes[node]["rmse_near"].value == pytest.approx(expected, rel=1e-12)


def test_runs_of_what_was_recorded_once_are_no_band(mrclam_folder: Path):
    setup = prepare(scenario("mrclam", data=str(mrclam_folder), target=4, steps=30))
    told = told_by(setup, 3)
    assert told.nees_low == told.nees_high == [None] * 30


def test_what_is_not_known_is_null_in_json(mrclam_folder: Path):
    """No node has seen the target in the first steps, and JSON has no NaN."""
    setup = prepare(scenario("mrclam", data=str(mrclam_folder), target=4, steps=3))
    figures = summary_of(setup, read_trace(setup, in_memory(setup)))
    json.loads(figures.as_json(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
