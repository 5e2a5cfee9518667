"""A warning is right if what it warns of happens, and does not happen without it."""

from collections.abc import Callable

import numpy as np
import pytest

from concord.plants.linear import LinearModel, LinearPlant, LinearSensor
from concord.results.records import record_spread
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios import catalogue
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.setup import Setup
from concord.scenarios.warnings import warnings_of

pytestmark = pytest.mark.slow


def setup_of(**changes) -> Setup:
    return prepare(definition_named("oscillator").defaults.with_(steps=5, **changes))


def quiet(**changes) -> bool:
    return warnings_of(setup_of(**changes)) == ()


# --- the average of a network with blind nodes, on a plant that grows ----------------------------


@pytest.fixture
def growing(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Setup]:
    """Setups of a scalar plant x -> F x + noise on a ring of eight, one of which sees it."""
    noise_std = np.full((8, 1), np.nan)
    noise_std[0] = 1e-3

    def make(growth: float, **changes) -> Setup:
        model = LinearModel(np.array([[growth]]), np.zeros((1, 0)), np.array([[0.01]]))
        plant = LinearPlant(
            name="growing",
            time_step_s=0.1,
            state_names=("x",),
            state_units=("1",),
            model=model,
            noise_factor=np.array([[0.1]]),
            sensors=LinearSensor(np.ones((8, 1, 1)), noise_std),
            initial_state=np.zeros(1),
            prior_cov=np.eye(1),
        )
        usual = definition_named("oscillator").defaults
        defaults = usual.with_(nodes=8, steps=70, rule="wac", hold="drop")
        definition = ScenarioDefinition(
            defaults=defaults,
            check=lambda _: None,
            plant=lambda _: plant,
            model=lambda _: model,
            sensor=lambda _, node: plant.sensor(node),
            score=Score((0,), "1", (0,), 0),
        )
        monkeypatch.setattr(catalogue, "chosen", lambda *_: definition)
        return prepare(defaults.with_(**changes))

    return make


def outcome(setup: Setup) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square error and largest variance over the nodes, per step."""
    found = read_trace(setup, in_memory(setup))
    errors = found.mean - found.truth[:, None]
    return np.sqrt((errors**2).mean(axis=(1, 2))), found.cov.max(axis=(1, 2, 3))


def per_step(values: np.ndarray) -> float:
    """The factor by which values grow, before numbers are too large for a sharp sensor."""
    return float((values[60] / values[30]) ** (1 / 30))


# The consensus study found this for the network (spectral facts of its section 3, item e).
@pytest.mark.parametrize(
    ("growth", "rounds", "what"),
    [
        (1.1, 1, "estimates and covariances"),
        (1.1, 5, "covariances"),
        (1.1, 20, "covariances"),
        (1.2, 5, "estimates and covariances"),
        (1.2, 20, "estimates and covariances"),
        (1.02, 20, None),
    ],
)
def test_the_average_diverges_just_where_the_condition_says(
    growing, growth: float, rounds: int, what: str | None
):
    setup = growing(growth, rounds=rounds)
    said = warnings_of(setup)
    error, variance = outcome(setup)
    # The ring as a circulant; node 0 sees, and forgets what the others think.
    shift = np.roll(np.eye(8), 1, axis=0)
    votes = np.linalg.matrix_power((np.eye(8) + shift + shift.T) / 3, rounds)[:, 1:]
    vote = np.abs(np.linalg.eigvals(votes[1:])).max()
    if what is None:
        assert said == ()
        assert variance.max() < 10
        return
    (sentence,) = said
    assert sentence.startswith(f"rule wac: {what} diverge")
    assert "the 7 of 8 nodes" in sentence
    assert "use --rule ci" in sentence
    assert per_step(variance) == pytest.approx(growth**2 * vote, rel=1e-3)
    if what == "covariances":
        assert error.max() < 10
    else:
        assert per_step(error) == pytest.approx(growth * vote, rel=0.02)


def test_what_is_recommended_instead_stays_bounded(growing):
    for growth, rounds in ((1.1, 1), (1.2, 5)):
        for change in ({"rule": "ci"}, {"hold": "decayed", "determinant_weights": True}):
            setup = growing(growth, rounds=rounds, **change)
            assert warnings_of(setup) == ()
            error, variance = outcome(setup)
            assert error.max() < 10
            assert variance.max() < 10


def test_a_stable_plant_needs_no_warning():
    assert quiet(rule="wac")
    assert quiet(rule="wac", rounds=1, graph="path")


# --- the average times the number of nodes -------------------------------------------------------


def test_rounds_must_suffice_for_one_per_cent_of_a_disagreement():
    """A ring of eight with Metropolis weights leaves (1 + 2 cos 45 deg) / 3 = .805 per round."""
    modulus = (1 + 2 * np.cos(np.pi / 4)) / 3
    needed = int(np.ceil(np.log(0.01) / np.log(modulus)))
    (sentence,) = warnings_of(setup_of(rule="icf", rounds=needed - 1))
    assert f"rule icf is overconfident after {needed - 1} rounds" in sentence
    assert "leave 0.805" in sentence
    assert f"--rounds {needed}" in sentence
    assert "--rule hcmci" in sentence
    assert quiet(rule="icf", rounds=needed)
    assert quiet(rule="icf", rounds=1, graph="complete")


def test_everybody_must_publish():
    common = {"rule": "icf", "rounds": 1, "graph": "complete"}
    (sentence,) = warnings_of(setup_of(**common, schedule="round-robin", occupancy=0.5))
    assert "--occupancy 0.5" in sentence
    for schedule in ("hybrid", "hybrid-leaves", "dynamic"):
        (sentence,) = warnings_of(setup_of(**common, schedule=schedule, trigger=0.1))
        assert "--trigger 0.1" in sentence


def test_the_safe_gain_needs_no_warning():
    assert quiet(rule="hcmci", rounds=1, graph="path")
    assert quiet(rule="hcmci", schedule="hybrid", occupancy=0.5)


# --- held shares, and rules that are not consistent ----------------------------------------------


@pytest.mark.parametrize("rule", ["ci", "wac"])
def test_raw_shares_are_a_failure_only_where_somebody_is_silent(rule: str):
    silent = {"schedule": "hybrid", "occupancy": 0.5}
    (sentence,) = warnings_of(setup_of(rule=rule, hold="raw", **silent))
    assert f"--hold raw with --occupancy 0.5: rule {rule}" in sentence
    assert "use --hold decayed" in sentence
    assert quiet(rule=rule, hold="raw")
    assert quiet(rule=rule, hold="predict", **silent)


@pytest.mark.parametrize("rule", ["kcf", "diffusion"])
def test_rules_that_do_not_fuse_covariances_say_so(rule: str):
    (sentence,) = warnings_of(setup_of(rule=rule))
    assert f"rule {rule} is not consistent" in sentence
    assert len(warnings_of(setup_of(rule=rule, rounds=1))) == 2


# --- links that lose frames ----------------------------------------------------------------------


def test_labelled_without_digests_never_makes_good_what_a_link_lost():
    """Every other frame is lost: with digests nearly all records arrive, without them fewer."""

    def coverage(**changes) -> float:
        setup = setup_of(rule="labelled", loss=0.5, **changes)
        setup = prepare(setup.scenario.with_(steps=60, window_steps=16))
        spread = read_trace(setup, in_memory(setup)).spread
        assert spread is not None
        return record_spread.figures_of(spread).coverage

    assert coverage(digest_steps=8) > 0.99
    assert coverage(digest_steps=0) < 0.95
    assert quiet(rule="labelled", loss=0.5, digest_steps=8)
    assert quiet(rule="labelled", loss=0.5)
    (warning,) = warnings_of(setup_of(rule="labelled", loss=0.5, digest_steps=0))
    assert "--digest-steps" in warning


# --- arbiters ------------------------------------------------------------------------------------


def of_arbiter(**changes) -> tuple[Setup, str]:
    setup = setup_of(nodes=8, graph="ring", schedule="dynamic", **changes)
    return setup, "\n".join(warnings_of(setup))


def test_one_frame_id_a_node_starves_the_last_nodes_where_all_do_not_fit():
    setup, said = of_arbiter(arbiter="minislot", occupancy=0.25)
    assert "8 nodes contend with one frame ID each" in said and "use --arbiter urgency" in said
    sent = read_trace(setup, in_memory(setup)).published.any(axis=(0, 1))
    held = int(sent.sum())
    assert held < 8 and sent.tolist() == [True] * held + [False] * (8 - held)
    assert f"holds {held} of their longest shares" in said


def test_urgency_classes_starve_no_node_and_need_no_warning():
    setup, said = of_arbiter(arbiter="urgency", occupancy=0.25)
    assert said == ""
    assert read_trace(setup, in_memory(setup)).published.any(axis=(0, 1)).all()
    # All shares fit: the order does not matter.
    assert of_arbiter(arbiter="minislot", occupancy=1.0)[1] == ""


@pytest.mark.parametrize("arbiter", ["wtod", "round-robin"])
def test_an_arbiter_that_knows_all_bids_is_called_ideal(arbiter: str):
    assert f"--arbiter {arbiter} is ideal" in of_arbiter(arbiter=arbiter, occupancy=0.25)[1]
