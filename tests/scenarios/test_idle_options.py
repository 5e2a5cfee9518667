"""An option is said to change nothing exactly where a run with it has the same bits."""

import msgspec
import pytest

from experiments.drivers import in_memory
from experiments.trace import read_trace
from scenarios.catalogue import kind_of
from scenarios.idle_options import idle_options
from scenarios.rules import RULE_SUMMARIES
from scenarios.scenario import Scenario
from scenarios.setup import Setup, prepare

# A network in which records come late, links lose frames and half of the nodes wait for a slot.
BUSY = {"graph": "grid", "nodes": 8, "rounds": 2, "steps": 25, "loss": 0.2}
CONTENDED = {"schedule": "hybrid", "occupancy": 0.5}
UNLIKE_DEFAULTS = {
    "weights": "maximum-degree",
    "arbiter": "round-robin",
    "trigger": 20.0,
    "decay": 0.1,
    "determinant_weights": False,
    "liars": 0,
    "number": "float32",
    "window_steps": 1,
    "digest_steps": 0,
    "gate_probability": 0.9,
    "record_number": "float32",
    "payload_bytes": 60,
}
# Alone, a node changes no estimate by what it sends; centralised does not run on this network.
FUSING = sorted(set(RULE_SUMMARIES) - {"local", "centralised", "ellipsoid", "zonotope"})


def setup_of(**changes) -> Setup:
    name = changes.pop("name", "oscillator")
    return prepare(msgspec.structs.replace(kind_of(name).defaults, **changes))


def estimates(setup: Setup) -> bytes:
    return read_trace(setup, in_memory(setup)).mean.tobytes()


def said_of(setup: Setup) -> list[str]:
    return [sentence.split()[0] for sentence in idle_options(setup)]


def in_words(field: str) -> str:
    return f"--{field.replace('_', '-')}"


@pytest.fixture(scope="module")
def usual() -> dict[str, bytes]:
    return {}


@pytest.mark.parametrize("field", UNLIKE_DEFAULTS)
@pytest.mark.parametrize("rule", FUSING)
def test_what_is_said_to_change_nothing_changes_no_bit(
    field: str, rule: str, usual: dict[str, bytes]
):
    if (field, rule) == ("trigger", "labelled"):
        pytest.skip("refused")
    if rule not in usual:
        usual[rule] = estimates(setup_of(**BUSY, **CONTENDED, rule=rule))
    setup = setup_of(**BUSY, **CONTENDED, rule=rule, **{field: UNLIKE_DEFAULTS[field]})
    said = said_of(setup)
    assert said in ([], [in_words(field)])
    assert bool(said) == (estimates(setup) == usual[rule])


@pytest.mark.parametrize("field", ["decay", "determinant_weights"])
@pytest.mark.parametrize("hold", ["drop", "raw", "predict", "renormalise", "in-step"])
def test_what_is_held_otherwise_has_no_decay(field: str, hold: str):
    common = {**BUSY, **CONTENDED, "hold": hold, "loss": 0.0}
    setup = setup_of(**common, **{field: UNLIKE_DEFAULTS[field]})
    assert said_of(setup) == [in_words(field)]
    assert estimates(setup) == estimates(setup_of(**common))


@pytest.mark.parametrize("field", ["arbiter", "trigger"])
@pytest.mark.parametrize("schedule", ["round-robin", "hybrid", "hybrid-leaves", "dynamic"])
def test_only_who_contends_is_served_or_asks(schedule: str, field: str):
    common = {**BUSY, "schedule": schedule, "occupancy": 0.5}
    setup = setup_of(**common, **{field: UNLIKE_DEFAULTS[field]})
    said = said_of(setup)
    assert said == ([in_words(field)] if schedule == "round-robin" else [])
    assert bool(said) == (estimates(setup) == estimates(setup_of(**common)))


@pytest.mark.parametrize("rule", ["ellipsoid", "zonotope"])
@pytest.mark.parametrize("field", ["weights", "decay", "determinant_weights", "trigger", "number"])
def test_sets_have_no_weights(rule: str, field: str):
    common = {"name": "liu2021-network", "rule": rule, "steps": 25, **CONTENDED}
    setup = setup_of(**common, **{field: UNLIKE_DEFAULTS[field]})
    assert bool(said_of(setup)) == (estimates(setup) == estimates(setup_of(**common)))


@pytest.mark.parametrize("field", ["arbiter", "weights", "decay", "number"])
def test_a_measurement_bus_has_contenders_and_no_weights(field: str):
    common = {"name": "meng2025", "steps": 25}
    setup = setup_of(**common, **{field: UNLIKE_DEFAULTS[field]})
    assert bool(said_of(setup)) == (estimates(setup) == estimates(setup_of(**common)))


def test_a_host_that_relays_nothing_latches_nothing():
    assert said_of(setup_of(latch_delay_us=7.0)) == ["--latch-delay-us"]
    assert said_of(setup_of(latch_delay_us=7.0, rule="labelled", relay=True)) == []


def test_what_a_script_comes_to_need_is_not_idle():
    common = {"graph": "complete", "nodes": 8, "liars": 2, "hold": "drop", "decay": 0.3}
    assert said_of(setup_of(**common, trigger=1.0)) == ["--trigger", "--decay", "--liars"]
    later = ("2 set rule=trimmed-ci hold=decayed", "3 set occupancy=.5")
    assert said_of(setup_of(**common, trigger=1.0, changes=later)) == []


def test_a_sentence_names_the_option_what_it_is_for_and_the_cure():
    switched, liars = idle_options(setup_of(rule="hcmci", liars=2, determinant_weights=False))
    assert liars == (
        "--liars 2 changes nothing here: it is for rule trimmed-ci alone; leave it out, or use that"
    )
    # As it is said on the command line.
    assert switched.startswith("--determinant-weights False changes nothing")


@pytest.mark.parametrize("name", ["oscillator", "meng2025", "liu2021-network", "target-tracking"])
def test_scenarios_as_they_come_have_none(name: str):
    assert isinstance(setup_of(name=name).scenario, Scenario)
    assert said_of(setup_of(name=name)) == []
