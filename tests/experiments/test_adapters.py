"""Values of other libraries in Python: taken for what they are, or refused in a sentence."""

from pathlib import Path
from typing import Any

import control
import networkx as nx
import numpy as np
import pytest
import scipy.signal
import scipy.sparse as sparse
import xarray as xr

import concord

# Many calls are wrong on purpose.
cc: Any = concord
BASE = cc.scenario("oscillator", nodes=4, steps=12, graph="path")
PATH = nx.to_numpy_array(nx.path_graph(4))
EDGES = [(0, 1), (1, 2), (2, 3)]
ONE_WAY = [(0, 1), (1, 0), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2)]
STEP = [[1, 1.0], [0, 1]], [[0.5], [1.0]], [[1, 0]]
LAW: dict[str, Any] = {"Q": [0.01, 0.01], "R": [1.0], "mean": [0, 0], "cov": [1, 1]}


def plant(**fields: Any) -> Any:
    return cc.OwnPlant(**{"f": lambda x: x, "Q": [1, 1], "mean": [0, 0], "cov": [1, 1], **fields})


def sensor(**fields: Any) -> Any:
    return cc.OwnSensor(**{"h": lambda x: x[..., :1], "R": 1.0, **fields})


@pytest.mark.parametrize(
    "graph",
    [
        nx.MultiGraph([*EDGES, EDGES[0]]), nx.MultiDiGraph(ONE_WAY), nx.Graph([*EDGES, (1, 1)]),
        sparse.csr_array(PATH), sparse.coo_matrix(PATH), xr.DataArray(PATH), PATH.astype(bool),
        PATH + np.eye(4), PATH.tolist(),
    ],
)  # fmt: skip
def test_a_graph_of_another_library_is_its_links(graph: Any):
    changed = BASE.with_(graph=graph)
    assert (changed.network.graph, changed.nodes) == ("edges:0-1;1-2;2-3", 4)
    assert cc.own_scenario(plant(), [sensor()], graph=graph).nodes == 4


@pytest.mark.parametrize(
    ("graph", "says"),
    [
        (np.where(PATH > 0, np.nan, 0), "entry nan in row 0, column 1: must be 0 or 1"),
        (-PATH, "entry -1 in row 0"),
        (0.3 * PATH, "entry 0.3 .*chances of delivery"),
        ([["a", "b"], ["c", "d"]], "a graph of type list: must be a name"),
        ([[0, 1], [1]], "a graph of type list"),
        (5, r"a graph of shape \(\)"),
        (np.ones((2, 3)), r"shape \(2, 3\)"),
        ({0: [1]}, "a graph of type dict"),
        (Path("a.graphml"), "a graph of type PosixPath"),
        (nx.Graph([("a", "b")]), "convert_node_labels_to_integers"),
        (nx.Graph(), "nodes 0: must be at least 1"),
    ],
)
def test_a_graph_that_is_none_is_refused(graph: Any, says: str):
    with pytest.raises(ValueError, match=says):
        BASE.with_(graph=graph)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: cc.simulate("target-tracking"), r"such as cc\.scenario\('target-tracking'\)"),
        (lambda: cc.launch(None), "scenario None of type NoneType"),
        (lambda: cc.agree(3), "scenario 3 of type int"),
        (lambda: cc.simulate(BASE, runs=2.5), "runs 2.5 of type float: must be a whole number"),
        (lambda: cc.plots(3), "plots 3 of type int: must be what cc.sweep or cc.design returns"),
        (lambda: cc.plots(cc.simulate(BASE)), "concord plot FOLDER"),
        (lambda: cc.own_scenario(1, [2]), "plant 1 of type int: must be an OwnPlant"),
        (lambda: cc.own_scenario(plant(), [2]), "entry 0 is of type int"),
        (lambda: cc.own_scenario(plant(), sensor()), "must be a list, such as"),
        (lambda: cc.own_scenario(plant(), [sensor()], scored_states=0), "scored_states 0"),
        (lambda: cc.own_scenario(plant(), [sensor()], nodes=0), "nodes 0: must be at least 1"),
        (lambda: cc.scenario("oscillator", occupancy=25), r"occupancy 25.0: must be in \(0, 1\]"),
        (lambda: BASE.with_(loss=2), "loss 2.0: must be at least 0 and below 1"),
        (lambda: cc.scenario("oscillator", changes=3), "changes 3 of type int"),
        (lambda: cc.scenario(3), "scenario 3 of type int"),
        (lambda: cc.load(3), "folder 3 of type int"),
        (lambda: cc.design(1.5, BASE), "target_rmse 1.5 of type float"),
        (lambda: cc.compare(3), "rules 3 of type int"),
        (lambda: cc.scenario("target-tracking", placement={"a": 1}), "is no site"),
        (lambda: cc.on_a_measurement_bus(plant(), 3), "sensors 3 of type int"),
        (lambda: plant(f=3), "f of type int: must be a function"),
        (lambda: plant(Q="ab"), "Q 'ab' of type str: it holds no real numbers"),
        (lambda: plant(Q=[1j, 1]), "Q of type list: it holds no real numbers"),
        (lambda: plant(mean=[], Q=[], cov=[]), "mean"),
        (lambda: plant(time_step_s="a"), "time_step_s a: must be above 0"),
        (lambda: plant(time_step_s=np.inf), "time_step_s inf"),
        (lambda: plant(state_names="ab"), "state_names ab: must be a tuple"),
        (lambda: plant(positions=[[0, np.nan]]), "two finite numbers"),
        (lambda: plant(angles=0), "angles 0: must be some of the states"),
        (lambda: sensor(R="a"), "R 'a' of type str"),
        (lambda: sensor(R=-1e-16), "R: has a negative eigenvalue"),
    ],
)
def test_a_wrong_argument_is_refused_in_a_sentence(call: Any, says: str):
    with pytest.raises(ValueError, match=says):
        call()


def test_covariances_come_in_every_form():
    for form in (np.eye(2), sparse.eye_array(2), xr.DataArray(np.eye(2)), [1, 1]):
        assert np.array_equal(plant(Q=form).noise_cov, np.eye(2))
        assert np.array_equal(sensor(R=form).noise_cov, np.eye(2))


def test_a_text_is_one_change():
    assert BASE.with_(changes="5 kill 3").changes == ("5 kill 3",)
    assert cc.scenario("oscillator", changes="5 kill 3").changes == ("5 kill 3",)
    swept = cc.sweep(BASE, changes="5 kill 3", runs=1)
    assert swept.equals(cc.sweep(BASE, changes=["5 kill 3"], runs=1))


def test_a_sweep_takes_arrays():
    found = cc.sweep(
        BASE, occupancy=xr.DataArray([0.25, 0.5]), graph=sparse.csr_array(PATH), runs=1
    )
    assert found.sizes["occupancy"] == 2


# --- linear systems ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("system", "asked_s", "step_s"),
    [
        (control.ss(*STEP, 0, 1.0), None, 1.0),
        (control.ss(*STEP, 0, 1), 1.0, 1.0),
        (control.ss(*STEP, 0, True), 0.1, 0.1),
        (scipy.signal.StateSpace(*STEP, [[0]], dt=0.5), None, 0.5),
        (scipy.signal.dlti(*STEP, [[0]]), 0.5, 0.5),
        (control.ss(STEP[0], STEP[1], STEP[2], [[7.0]], 1.0), None, 1.0),
    ],
)
def test_a_sampled_system_keeps_its_matrix(system: Any, asked_s: float | None, step_s: float):
    own, output = cc.from_control(system, **LAW, time_step_s=asked_s)
    assert own.time_step_s == step_s
    assert np.array_equal(own.f(np.array([2.0, 1.0])), [3.0, 1.0])
    assert np.array_equal(output.h(np.array([2.0, 1.0])), [2.0])


@pytest.mark.parametrize(
    "system",
    [
        control.ss(*STEP, 0, 0),
        scipy.signal.StateSpace(*STEP, [[0]]),
        scipy.signal.lti(*STEP, [[0]]),
    ],
)
def test_a_continuous_system_is_sampled(system: Any):
    own, _ = cc.from_control(system, **LAW, time_step_s=0.1)
    growth = np.exp(0.1)
    assert own.f(np.array([0.0, 1.0])) == pytest.approx([0.1 * growth, growth])


@pytest.mark.parametrize(
    ("system", "asked_s", "says"),
    [
        (control.ss(*STEP, 0, 1.0), 0.1, "time_step_s 0.1: the system is sampled at 1.0 s"),
        (control.ss(*STEP, 0, True), None, "no sampling time; give time_step_s"),
        (control.ss(*STEP, 0, None), 0.1, "may be continuous or sampled; give it dt 0"),
        (scipy.signal.StateSpace(*STEP, [[0]]), None, "no sampling time"),
        (control.tf([1], [1, 1, 1]), 0.1, "a TransferFunction has no states .*control.ss"),
        (scipy.signal.TransferFunction([1], [1, 1]), 0.1, "has no states"),
        (control.frd([1, 2], [1, 2]), 0.1, "a FrequencyResponseData has no states"),
        (3, 0.1, "a int has no states"),
        (control.ss(*STEP, 0, 0), -1, "time_step_s -1: must be a finite number above 0"),
        (control.ss([[np.nan, 1], [0, 1]], *STEP[1:], 0, 1.0), None, "A and C must be finite"),
    ],
)
def test_a_system_that_is_none_is_refused(system: Any, asked_s: float | None, says: str):
    with pytest.raises(ValueError, match=says):
        cc.from_control(system, **LAW, time_step_s=asked_s)


def test_the_noise_must_have_the_size_of_the_outputs():
    with pytest.raises(ValueError, match=r"R of shape \(2,\): must be \(1, 1\)"):
        cc.from_control(control.ss(*STEP, 0, 1.0), **{**LAW, "R": [1, 1]})
