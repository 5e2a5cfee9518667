"""A plant that is moved and scaled has the moved and scaled answer, in every rule and format.

Nodes write states about the prior mean and readings about the reading that it gives, and count what
is rounded. The distance of a plant from zero, and its units, therefore change nothing.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy import stats

from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.results.records.trace import read_trace
from concord.runtime.drivers import DRIVERS, in_memory
from concord.scenarios.catalogue import definition_named
from concord.scenarios.definitions.own import own_scenario
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.warnings import warnings_of
from concord.studies.monte_carlo.simulate import COV, simulate
from tests.experiments.support import trace_of

RUNS, STEPS, FIRST = 6, 30, 5
# Rules with the formats of their shares; of these, rules whose covariances promise a bound.
FORMATS = {
    **dict.fromkeys(("ci", "sharp-ci", "wac", "hcmci", "icf"), ("float64", "float32", "float16")),
    # A step of float16 may change which neighbour trimmed-ci leaves out.
    "trimmed-ci": ("float64", "float32"),
    "local": ("float32", "float16"),
    **dict.fromkeys(("diffusion", "kcf"), ("float64", "float32")),
    "labelled": ("float64", "float32", "int16", "int12"),
}
CASES = [(rule, number) for rule, numbers in FORMATS.items() for number in numbers]
CAUTIOUS, EXACT = ("ci", "sharp-ci", "wac", "hcmci"), ("labelled",)
# Rounding of doubles 1e7 away may move a number to the next step of its format. These are parts of
# the standard deviation of an estimate that a few such steps move it by.
STEP = {"float64": 1e-2, "float32": 1e-2, "float16": 0.25, "int16": 0.25, "int12": 0.7}


def plant_at(seed: int, shift: np.ndarray, scale: float, **options: object) -> Scenario:
    """A drawn plant z with x = shift + scale z, seen by linear and bent sensors; node 1 is blind.

    Readings are moved and scaled like states.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    axes, _ = np.linalg.qr(rng.normal(size=(n, n)))
    turn = 0.98 * axes
    away = shift[:n]
    rows = rng.normal(size=(3, n))
    deviations = 10.0 ** rng.uniform(-2, 0, 3)
    middle = rng.normal(size=n)

    def inside(x: np.ndarray) -> np.ndarray:
        return (x - away) / scale

    def read(row: np.ndarray, bend: float):
        def h(x: np.ndarray) -> np.ndarray:
            value = inside(x) @ row
            return (shift[0] + scale * (value + bend * np.tanh(value)))[..., None]

        return h

    plant = OwnPlant(
        f=lambda x: away + scale * (middle + (inside(x) - middle) @ turn.T),
        Q=np.full(n, (0.03 * scale) ** 2),
        mean=away + scale * middle,
        cov=np.full(n, scale**2),
    )
    sensors = [
        OwnSensor(h=read(rows[0], 0.0), R=(deviations[0] * scale) ** 2),
        None,
        OwnSensor(h=read(rows[1], 0.1), R=(deviations[1] * scale) ** 2),
        OwnSensor(h=read(rows[2], 0.0), R=(deviations[2] * scale) ** 2),
    ]
    made = own_scenario(plant, sensors, graph="ring", steps=STEPS, first_scored_step=FIRST)
    if options["rule"] == "labelled":
        options["record_number"] = options.pop("number")
    return made.with_(seed=seed, **options)


def moved_answers(
    seed: int, shift: np.ndarray, scale: float, rule: str, number: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Estimates at home and, moved back, of the moved plant; deviations at home; NEES of both."""
    options = {"rule": rule, "number": number}
    here = simulate(prepare(plant_at(seed, np.zeros(3), 1.0, **options)), range(RUNS), keep=[COV])
    there = simulate(prepare(plant_at(seed, shift, scale, **options)), range(RUNS), keep=[COV])
    n = here.mean.shape[-1]
    assert here.cov is not None
    back = (there.mean - shift[:n]) / scale
    deviation = np.sqrt(np.diagonal(here.cov, axis1=-2, axis2=-1))
    nees = np.stack((here.nees, there.nees))[:, :, FIRST:].mean(axis=(2, 3)) / n
    return here.mean, back, deviation, nees


def check_moved(seed: int, shift: np.ndarray, scale: float, rule: str, number: str) -> None:
    if rule == "kcf":
        scale = 1.0  # its rate of the pull has the norm of a covariance, and so its units
    here, back, deviation, nees = moved_answers(seed, shift, scale, rule, number)
    # Doubles lose their last bits to the distance: some of them in each of a step's operations.
    lost = 100 * np.finfo(float).eps * np.abs(shift).max() / scale
    assert (np.abs(back - here) <= STEP[number] * deviation + lost).all()
    half = stats.t.ppf(0.9999, RUNS - 1) * nees.std(axis=1, ddof=1) / np.sqrt(RUNS)
    for middle, width in zip(nees.mean(axis=1), half, strict=True):
        if rule in EXACT:
            assert middle - width <= 1.0 <= middle + width
        elif rule in CAUTIOUS:
            assert middle - width <= 1.0


# To shrink takes long, and a drawn case says as much.
PHASES = (Phase.explicit, Phase.reuse, Phase.generate)
SHIFTS = st.lists(st.floats(-1e7, 1e7), min_size=3, max_size=3).map(np.array)
SCALES = st.floats(-4, 6).map(lambda power: 10.0**power)
SEEDS = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize(("rule", "number"), CASES)
@settings(max_examples=2, deadline=None, phases=PHASES)
@given(SEEDS, SHIFTS, SCALES)
def test_a_moved_plant_has_the_moved_answer(
    rule: str, number: str, seed: int, shift: np.ndarray, scale: float
):
    check_moved(seed, shift, scale, rule, number)


@pytest.mark.study
@pytest.mark.parametrize(("rule", "number"), CASES)
@settings(max_examples=6, deadline=None, phases=PHASES)
@given(SEEDS, SHIFTS, SCALES)
def test_many_moved_plants_have_the_moved_answer(
    rule: str, number: str, seed: int, shift: np.ndarray, scale: float
):
    check_moved(seed, shift, scale, rule, number)


@pytest.mark.parametrize(("rule", "number"), [("hcmci", "float32"), ("labelled", "int16")])
def test_messages_have_the_moved_answer(rule: str, number: str):
    """The driver of messages, beside the arrays of the test above."""
    shift = np.array([5.4e6, -3e6, 1e7])
    here = prepare(plant_at(3, np.zeros(3), 1.0, rule=rule, number=number))
    there = prepare(plant_at(3, shift, 0.25, rule=rule, number=number))
    one, other = (read_trace(setup, in_memory(setup)) for setup in (here, there))
    deviation = np.sqrt(np.diagonal(one.cov, axis1=-2, axis2=-1))
    back = (other.mean - shift[: one.mean.shape[-1]]) / 0.25
    assert (np.abs(back - one.mean) <= STEP[number] * deviation + 1e-6).all()


SCENARIO = """
import numpy as np
import concord as cc

PLANT = cc.OwnPlant(
    f=lambda x: 5.4e6 + 0.9 * (x - 5.4e6), Q=[1e-4], mean=[5.4e6], cov=[1.0], time_step_s=0.1
)
FAR = cc.own_scenario(PLANT, [cc.OwnSensor(h=lambda x: x, R=[4e-4]), None], nodes=4, steps=12)
"""


@pytest.mark.slow
@pytest.mark.zenoh
@pytest.mark.parametrize(
    ("rule", "number"), [("ci", "float16"), ("icf", "float32"), ("labelled", "int12")]
)
def test_processes_have_the_bits_of_messages(
    rule: str, number: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "far.py").write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    option = {"record_number": number} if rule == "labelled" else {"number": number}
    setup: Setup = prepare(definition_named("far.py:FAR").defaults.with_(rule=rule, **option))
    traces = []
    for name, run in DRIVERS.items():
        file = tmp_path / f"{name}.mcap"
        run(setup, name, file, None, lambda _: None)
        traces.append(trace_of(setup, file))
    for other in traces[1:]:
        np.testing.assert_array_equal(traces[0].mean, other.mean)
        np.testing.assert_array_equal(traces[0].cov, other.cov)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rule": "labelled"}, "--record-number int16: from step 2 on .* sent as float64"),
        (
            {"rule": "labelled", "record_number": "float32"},
            "--record-number float32: from step 11 on",
        ),
        ({"rule": "ci", "number": "float16"}, "--number float16: from step 1 on .* lose digits"),
        ({"rule": "ci", "number": "float32"}, ""),
        ({"rule": "labelled", "record_number": "float64"}, ""),
    ],
)
def test_a_plant_that_leaves_the_range_of_a_format_is_told(options: dict, said: str):
    """It moves 30 in a step, and readings are good to 0.02."""
    plant = OwnPlant(
        f=lambda x: np.stack((x[..., 0] + x[..., 1], x[..., 1]), -1),
        Q=[1e-6, 1e-6],
        mean=[5e6, 30.0],
        cov=[1.0, 0.01],
    )
    sensor = OwnSensor(h=lambda x: x[..., :1], R=4e-4)
    made = own_scenario(plant, [sensor, None], nodes=5, steps=40).with_(**options)
    found = " ".join(one for one in warnings_of(prepare(made)) if "number" in one)
    assert (said and re.search(said, found)) or (not said and not found)
    if options["rule"] == "labelled":
        # All readings arrive, in whatever form.
        histories = simulate(prepare(made), [0])
        assert (histories.nees[:, 5:].mean() / 2) < 3
        assert ("record-range" in histories.counters) == bool(said)
