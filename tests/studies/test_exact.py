"""`cc.exact` against brute force: one run of the network for each unit of all noise."""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

import concord as cc
from concord.experiments.cli.design import lines
from concord.filters.gaussian import Gaussian
from concord.runtime.batched.build import build_network
from concord.runtime.batched.driver import run
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.rules import hold_of
from concord.studies.design import candidates
from concord.studies.exact.averaged_errors import propagate as averaged
from concord.studies.exact.averaged_rules import RULES
from concord.studies.exact.network import exact_network, linear_network
from concord.studies.exact.results import Exact, exact_of
from concord.studies.monte_carlo.simulate import simulate
from concord.studies.sweep.pieces import Piece

STEPS = 9
HELD = {"schedule": "round-robin", "occupancy": 0.25}


def case(name: str = "oscillator", **options: Any) -> Scenario:
    usual = {"rule": "ci", "rounds": 2, "schedule": "full", "steps": STEPS, "nodes": 4}
    return cc.scenario(name, **{**usual, **options})


MOVE = np.array([[1.0, 0.1], [0.0, 0.95]])


def place(x: np.ndarray) -> np.ndarray:
    return x[..., :1]


PLACE = cc.OwnSensor(h=place, R=0.1)


def own(sensors: list[Any], truth: Any = None, **motion: Any) -> Scenario:
    """An own linear plant with these sensors, in float64 over 30 steps."""
    motion = motion or {"f": lambda x: x @ MOVE.T}
    plant = cc.OwnPlant(**motion, Q=[1e-3, 1e-2], mean=[1, 0], cov=[1, 1], time_step_s=0.1)
    asked = cc.own_scenario(plant, sensors, truth=truth, steps=30)
    return asked.with_(number="float64", schedule="full", bus="ideal", filter="kf")


def brute(scenario: Scenario) -> tuple[np.ndarray, ...]:
    """E[e e'] (S, N, n, n), reported covariances, E[e] (S, N, n): a run for each unit of noise."""
    exact = exact_network(prepare(scenario))
    whole = build_network(exact.setup, [scenario.run])
    n, shapes = whole.initial_state.shape[1], (whole.process.shape, whole.measurement.shape)
    sizes = (n, *(int(np.prod(shape)) for shape in shapes))
    units = np.eye(sum(sizes) + 1, sum(sizes), k=-1)
    start, process, measurement = np.split(units, np.cumsum(sizes)[:-1], axis=1)
    state, mean, cov = exact.plant.initial(start)
    runs, nodes = len(units), scenario.nodes
    network = build_network(exact.setup, [scenario.run] * runs)
    network = dataclasses.replace(
        network,
        plant=whole.plant,
        initial_state=state,
        prior=Gaussian(
            np.repeat(mean[:, None], nodes, axis=1), np.broadcast_to(cov, (runs, nodes, n, n))
        ),
        process=np.moveaxis(process.reshape(runs, shapes[0][0], -1), 0, 1),
        measurement=np.moveaxis(measurement.reshape(runs, shapes[1][0], *shapes[1][2:]), 0, 1),
    )
    errors, covs, biases = [], [], []
    for instant in run(network):
        error = instant.belief.mean - instant.truth[:, None]
        effects = error[1:] - error[:1]
        bias = error[0]
        errors.append(
            np.einsum("rni,rnj->nij", effects, effects) + bias[..., None] * bias[..., None, :]
        )
        covs.append(instant.belief.cov[0])
        biases.append(bias)
    return np.stack(errors), np.stack(covs), np.stack(biases)


def deviation(found: np.ndarray, expected: np.ndarray) -> float:
    """The largest difference in units of the standard deviations of both entries."""
    std = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
    return float((np.abs(found - expected) / (std[..., None] * std[..., None, :])).max())


CASES = {
    "ci": case(),
    "wac": case(rule="wac"),
    "hcmci": case(rule="hcmci"),
    "icf": case(rule="icf"),
    "kcf": case(rule="kcf"),
    "diffusion": case(rule="diffusion"),
    "local": case(rule="local"),
    "sharp-ci": case(rule="sharp-ci"),
    "centralised": case(rule="centralised", graph="complete", rounds=1),
    "held, decayed": case(**HELD),
    "held, decayed, one round": case(**HELD, rounds=1, hold="decayed", determinant_weights=False),
    "held, predicted": case(**HELD, hold="predict"),
    "held as it was": case(**HELD, hold="raw"),
    "held, dropped": case(**HELD, hold="drop"),
    "held, renormalised": case(**HELD, hold="renormalise"),
    "held in the step": case(**HELD, hold="in-step"),
    "held, hcmci": case(**HELD, rule="hcmci"),
    "losses": case(loss=0.3, run=3),
    "losses and turns": case(**HELD, loss=0.3, run=2),
    "losses, kcf": case(loss=0.3, run=3, rule="kcf"),
    "links that come and go": case(links="markov:0.3,0.5", run=1),
    "road that no filter knows": case("suspension"),
    "controller": case("dc-motor-position"),
    "unstable, blind nodes": case("dc-motor-position", control="open", nodes=6),
    "wrong Q": case("dc-motor-speed", noise="paper"),
}


@pytest.mark.parametrize("name", CASES)
def test_exact_is_brute_force(name: str):
    scenario = CASES[name]
    expected, covs, bias = brute(scenario)
    found = exact_of(prepare(scenario), [scenario.run])
    assert deviation(found.errors[0], expected) < 1e-12
    assert deviation(found.reported[0], covs) < 1e-12
    assert np.abs(found.bias[0] - bias).max() <= 1e-9 * np.sqrt(expected.max())


@pytest.mark.parametrize(
    "truth",
    [
        cc.Truth(Q=[0.01, 0.2]),
        cc.Truth(sensors=[cc.TrueSensor(R=0.4), None, cc.TrueSensor(R=0.01)]),
        cc.Truth(sensors=[cc.TrueSensor(bias=0.4), None, cc.TrueSensor(bias=-0.1)]),
        cc.Truth(f=lambda x: x @ np.array([[0.98, -0.2], [0.12, 0.9]])),
        cc.Truth(mean=[0.5, 0.0], cov=[0.1, 0.2]),
    ],
    ids=["Q", "R", "bias", "F", "start"],
)
@pytest.mark.parametrize("options", [{}, HELD], ids=["full", "held"])
def test_a_wrong_belief_is_brute_force(truth: Any, options: dict[str, Any]):
    speed = cc.OwnSensor(h=lambda x: x[..., 1:], R=0.2)
    scenario = own([PLACE, None, speed], truth=truth).with_(rounds=2, steps=STEPS, **options)
    expected, _, bias = brute(scenario)
    found = cc.exact(scenario)
    assert deviation(found.errors[0], expected) < 1e-12
    assert np.abs(found.bias[0] - bias).max() < 1e-12


@pytest.mark.parametrize("rule", RULES)
def test_both_exact_forms_agree_where_all_publish(rule: str):
    hold: Any = {"hold": "renormalise"} if hold_of(case(rule=rule).rule) is not None else {}
    scenario = case(rule=rule, steps=40, **hold)
    setup = prepare(scenario)
    weights = np.zeros((4, 4))
    for node, (heard, row) in enumerate(zip(setup.neighbours, setup.weights, strict=True)):
        weights[node, [node, *heard]] = row
    averaging = np.linalg.matrix_power(weights, scenario.rounds)
    network = linear_network(setup)
    # The oscillator begins apart from a prior mean that is known.
    *_, last = averaged(network, RULES[rule], averaging, scenario.steps)
    found = exact_of(setup)
    own = np.stack([last.errors[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(4)])
    assert deviation(found.errors[0, -1], own) < 1e-10
    assert deviation(found.centralised[-1], last.central_cov) < 1e-10


def test_patterns_are_those_of_the_runs():
    scenario = case(loss=0.3, steps=5)
    together = cc.exact(scenario, patterns=3)
    alone = cc.exact(scenario.with_(run=2), patterns=1)
    assert deviation(together.errors[2], alone.errors[0]) < 1e-12
    assert together.rmse.low < together.rmse.value < together.rmse.high


@pytest.mark.slow
def test_runs_with_losses_differ_by_noise_alone_from_what_their_patterns_give():
    """In pairs of one pattern, since the errors of one step and node over patterns are skewed."""
    scenario, count = case(loss=0.3, nodes=5, steps=12, rounds=1), 400
    setup = prepare(scenario)
    exact = exact_of(setup, range(count))
    runs = simulate(exact_network(setup).setup, range(count), keep=())
    states = list(definition_of(scenario).score.states)
    errors = (runs.mean - runs.truth[:, :, None])[..., states]
    rest = (errors**2).sum(-1) - exact.squares
    z = rest.mean(0) / (rest.std(0, ddof=1) / np.sqrt(count))
    assert np.abs(z).max() < 4
    assert 0.5 < np.sqrt((z**2).mean()) < 1.5


def test_a_steady_period_repeats_and_the_worst_phase_is_told():
    found: Exact = cc.exact(case(**HELD, rounds=1, steps=400))
    error = found.squares[0].mean(axis=-1)
    assert found.period_steps == 4
    assert found.steady.settled
    assert error[-4:] == pytest.approx(error[-8:-4], rel=1e-9)
    assert error[-4:].argmax() == (found.steady.worst_phase - 396) % 4
    assert found.steady.worst_error == pytest.approx(np.sqrt(error[-4:].max()))
    assert 0 < found.steady.rate < 1


def test_honesty_of_a_centralised_filter_is_one():
    found = cc.exact(CASES["centralised"])
    assert found.honesty == pytest.approx(1)
    assert found.overconfidence == pytest.approx(1)
    assert found.anees == pytest.approx(1)
    assert found.rmse.value == pytest.approx(found.rmse_centralised)


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        (cc.scenario("target-tracking", number="float64"), "its plant is not linear"),
        (cc.scenario("target-tracking"), "--number float16 --exact"),
        (case(rule="labelled"), "--number int16 --exact"),
        (case(rule="labelled", record_number="float64"), "rule labelled --exact"),
        (case(schedule="dynamic", occupancy=0.5), "nodes contend for slots"),
        (case(changes="3 kill 1"), "--changes with --exact"),
        (case(rule="trimmed-ci", graph="complete"), "rule trimmed-ci --exact"),
        (case(filter="iplf"), "--filter iplf --exact"),
        (case("dc-motor-position", hold="raw", **HELD), "use --control open"),
        (own([cc.OwnSensor(h=place, R=0.1, every_s=0.2)]), "does not read in every step"),
        (own([cc.OwnSensor(h=place, R=0.1, missing=0.2)]), "does not read in every step"),
        (
            own([PLACE], truth=cc.Truth(sensors=[cc.TrueSensor(h=lambda x: 2 * x[..., :1])])),
            "a filter believes another sensor",
        ),
        (own([PLACE], truth=cc.Truth(sensors=[cc.TrueSensor(outlier_share=0.1)])), "is not normal"),
        (
            own(
                [PLACE],
                f=lambda x, u: x @ MOVE.T + u,
                inputs=np.ones(40),
                truth=cc.Truth(f=lambda x, u: 0.9 * x @ MOVE.T + u),
            ),
            "its inputs move the state",
        ),
    ],
)
def test_what_is_not_exact_is_refused_in_a_sentence(scenario: Scenario, why: str):
    with pytest.raises(ValueError, match=re.escape(why)):
        exact_of(prepare(scenario))


def test_inputs_that_the_filters_know_change_no_error():
    driven = own([PLACE, None], f=lambda x, u: x @ MOVE.T + u, inputs=np.arange(40.0))
    plain = cc.exact(own([PLACE, None]))
    np.testing.assert_allclose(cc.exact(driven).squares, plain.squares, rtol=1e-9)


def test_exact_figures_stand_under_the_names_of_runs():
    scenario = case(steps=40)
    exact = cc.sweep(scenario, rule=["ci", "kcf"], runs=3, exact=True)
    runs = cc.sweep(scenario, rule=["ci", "kcf"], runs=400)
    assert set(exact.data_vars) == set(runs.data_vars)
    for name in ("rmse", "rmse_centralised", "disagreement", "rmse_node", "rmse_state"):
        squares = runs[name] ** 2
        half = 4 * squares.std("run") / np.sqrt(400)
        assert (np.abs(exact[name].isel(run=0) ** 2 - squares.mean("run")) < half).all()
    assert (exact["anees"].std("run") == 0).all()
    assert exact["bytes_per_step"].equals(runs["bytes_per_step"].isel(run=slice(3)))


def test_a_sweep_refuses_a_cell_without_exact_figures():
    with pytest.raises(ValueError, match="cell rule=labelled"):
        cc.sweep(case(), rule=["ci", "labelled"], exact=True)


def test_a_design_takes_exact_figures_and_runs_for_the_rest():
    options: Any = {"graph": "ring", "rounds": 1, "weights": "metropolis", "schedule": "full"}
    found = cc.design(
        "1.6x-centralised", case(steps=40), exact=True, runs=4,
        rule=["ci", "hcmci", "labelled"], **options,
    )  # fmt: skip
    assert found.recommended is not None
    widths = {one.values["rule"]: one.error.high - one.error.low for one in found.tried}
    assert widths["ci"] < 1e-12 and widths["hcmci"] < 1e-12 < widths["labelled"]
    assert all(one.exact == (one.error.high - one.error.low < 1e-12) for one in found.tried)


def test_a_design_computes_an_exact_candidate_once(monkeypatch: pytest.MonkeyPatch):
    """Not again in each round of its race, nor for the confirmation."""
    computed: list[str] = []
    compute = candidates.compute

    def counted(piece: Piece) -> dict[str, np.ndarray]:
        computed.append(piece.scenario.decode())
        return compute(piece)

    monkeypatch.setattr(candidates, "compute", counted)
    options: Any = {"graph": "ring", "weights": "metropolis", "number": "float64"}
    found = cc.design(
        "1.6x-centralised", case(steps=40), exact=True, workers=1, rule="ci", rounds=[1, 2],
        schedule="full", **options,
    )  # fmt: skip
    assert "exactly, without runs" in " ".join(lines(found))
    assert found.recommended is not None and found.recommended.exact
    assert len(computed) == len(found.tried)
