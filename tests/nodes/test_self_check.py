"""A node that is lost says so, asks for help and is healed; a sound node does none of this."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtri
from scipy.stats import binom

from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.labelled import BatchedFlooding
from concord.nodes.lanes.labelled_check import BatchedSelfChecked
from concord.nodes.rules.labelled.checked import SelfCheckedFlooding
from concord.nodes.rules.labelled.flooding import LabelledFlooding
from concord.nodes.rules.labelled.record_sets import SILENCE, URGENCY
from concord.nodes.rules.labelled.self_check import SUSPECT, chi_square_bound
from concord.nodes.rules.labelled.window_filter import Windows
from concord.results.records.runs import Runs
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_node
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table import labelled_rule
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate
from concord.studies.near_agreement import departures

STEPS, LOST_STEP, LOST_NODE = 24, 12, 2
# Beyond this a state of two numbers is wrong, whatever the noise.
IMPOSSIBLE = float(chdtri(2, 1e-9))


def ring(**options: Any) -> Setup:
    asked = {
        "nodes": 5, "graph": "ring", "rule": "labelled", "record_number": "float64",
        "window_steps": 10, "steps": STEPS, "loss": 0.2, "stretch": 100.0, **options,
    }  # fmt: skip
    return prepare(scenario_of("oscillator", **asked))


@pytest.mark.parametrize("probability", [1e-2, 1e-3, 1e-6])
def test_the_bound_is_that_of_chi_square(probability: float):
    freedom = np.array([1, 2, 3, 5, 8, 20, 100, 1000])
    exact = chdtri(freedom, probability)
    found = chi_square_bound(freedom, probability)
    assert (found > 0.99 * exact).all() and (found < 1.16 * exact).all()
    assert (found[3:] < 1.05 * exact[3:]).all()


def test_sound_nodes_are_suspect_as_rarely_as_they_promise():
    """On a linear plant the surprise is chi-square, and runs are independent."""
    runs = 2000
    setup = ring(nodes=2, graph="path", loss=0.0, steps=8)
    suspect = simulate(setup, range(runs), keep=()).suspect
    assert suspect is not None
    count = int(suspect[:, -1, 0].sum())
    assert binom.ppf(1e-6, runs, SUSPECT) <= count <= binom.isf(1e-6, runs, SUSPECT)


def test_silence_alone_makes_no_node_suspect():
    """Only surprising records are sent: a check that leaves silence out doubts every node."""
    runs = 400
    setup = ring(nodes=2, graph="path", loss=0.0, steps=20, withhold_below=0.4)
    found = simulate(setup, range(runs), keep=())
    assert found.suspect is not None
    assert int(found.suspect[:, -1, 0].sum()) <= binom.isf(1e-6, runs, SUSPECT)
    # The innovations that pass are larger than those of a matched filter.
    loud = _without_silence(setup, runs)
    assert loud > binom.isf(1e-6, runs, SUSPECT)


def _without_silence(setup: Setup, runs: int) -> int:
    """How many runs end with a suspect node 0 if records that are not there do not count."""
    usual = labelled_rule.WindowFilter
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(labelled_rule, "WindowFilter", lambda *given: usual(*given[:4]))
        suspect = simulate(setup, range(runs), keep=()).suspect
    assert suspect is not None
    return int(suspect[:, -1, 0].sum())


def wrong_and_sure(windows: Windows, node: int, step: int) -> Windows:
    """Windows of nodes from `node` on, of which the lost one's base is far off at that step."""
    lane = LOST_NODE - node
    if step != LOST_STEP or not 0 <= lane < windows.right.shape[1]:
        return windows
    mean, cov, right = windows.base.mean.copy(), windows.base.cov.copy(), windows.right.copy()
    mean[:, lane] += 50.0
    cov[:, lane] *= 1e-3
    right[:, lane] = 0
    return windows._replace(base=Gaussian(mean, cov), right=right)


def losing(one: type, many: type) -> dict[str, type]:
    """The rule at a node and in arrays, with a node that gets lost."""

    @dataclass(frozen=True)
    class Losing(one):
        def begin_step(self, content: Any, measured: Any) -> Any:
            content, failures = super().begin_step(content, measured)
            windows = wrong_and_sure(content.windows, self.node, measured.step)
            return content._replace(kept=content.kept._replace(windows=windows)), failures

    @dataclass(frozen=True)
    class LosingInArrays(many):
        def begin_step(self, content: Any, readings: Any, control: Any, step: int) -> Any:
            content = super().begin_step(content, readings, control, step)
            windows = wrong_and_sure(content.windows, 0, step)
            return content._replace(kept=content.kept._replace(windows=windows))

    return {"SelfCheckedFlooding": Losing, "BatchedSelfChecked": LosingInArrays}


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Setup, Runs, Trace]]:
    """Run the ring with a node that gets lost, in arrays and message by message."""

    def run(one: type, many: type, **options: Any) -> tuple[Setup, Runs, Trace]:
        for name, kind in losing(one, many).items():
            monkeypatch.setattr(labelled_rule, name, kind)
        setup = ring(**options)
        return setup, simulate(setup, [0]), read_trace(setup, in_memory(setup))

    return run


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"loss": 0.0, "schedule": "full"},
        {"schedule": "dynamic", "occupancy": 0.4, "digest_steps": 3},
        {"relay": True, "occupancy": 0.6},
        {"rounds": 1},
    ],
)
def test_a_lost_node_says_so_and_is_healed(ran: Callable[..., Any], options: dict[str, Any]):
    kinds = SelfCheckedFlooding, BatchedSelfChecked
    setup, histories, trace = ran(*kinds, **options)
    assert not departures(setup, trace)
    nees, suspect = histories.nees[0, :, LOST_NODE], histories.suspect[0]
    wrong = np.flatnonzero(nees > IMPOSSIBLE)
    assert len(wrong) and wrong[0] == LOST_STEP
    assert suspect[wrong, LOST_NODE].all(), "a belief that is surely wrong is suspect"
    assert trace.counters[LOST_NODE]["checkpoint-adopted"] >= 1
    assert not suspect[-5:].any() and (nees[-5:] < IMPOSSIBLE).all()
    others = np.delete(histories.nees[0], LOST_NODE, axis=1)
    assert (others < IMPOSSIBLE).all(), "a lost node draws no other along"
    _, _, unhelped = ran(LabelledFlooding, BatchedFlooding, **options)
    off = [np.abs(one.mean[:, LOST_NODE] - one.truth).sum() for one in (trace, unhelped)]
    assert off[0] < off[1]


def test_a_lost_node_sends_no_checkpoint_and_bids_with_urgency():
    rule = estimator()
    content = rule.start()._replace(owed=True, cycle=3)
    after, body = rule.compose(content)
    share = rule.accept(body)
    assert share.checkpoint is not None and not share.suspect and not after.owed
    after, body = rule.compose(lost(content))
    share = rule.accept(body)
    assert share.checkpoint is None and share.suspect and after.owed
    calm, urgent = rule.bid(content), rule.bid(lost(content))
    assert calm is not None and urgent is not None and urgent - calm == URGENCY * SILENCE
    asked = content._replace(owed=False, sent_cycle=content.cycle)
    assert rule.bid(lost(asked)) == rule.bid(asked), "it has asked in this step"


def test_nodes_that_ask_for_help_leave_slots_to_those_with_news():
    """A biased sensor made all nodes ask; low frame IDs took all slots, and the others starved."""
    told = {"nodes": 4, "graph": "path", "loss": 0.0, "window_steps": None, "steps": 24}
    bus = {"schedule": "dynamic", "occupancy": 0.5, "arbiter": "minislot", "relay": True}
    setup = ring(**told, **bus, changes=("6 bias 2 6", "11 calm"))
    trace = read_trace(setup, in_memory(setup))
    assert not departures(setup, trace)
    spread = np.linalg.slogdet(trace.cov)[1]
    np.testing.assert_allclose(spread, np.broadcast_to(spread[:, :1], spread.shape), atol=1e-6)


def test_a_node_helps_a_lost_neighbour_unless_it_is_lost_itself():
    rule = estimator()
    # Records of a step that is older than a digest.
    begun = rule.start()
    held, known = begun.kept.held.copy(), begun.near.known.copy()
    held[1] = known[..., 1, :] = 0b11111
    everything = begun._replace(
        kept=begun.kept._replace(held=held), near=begun.near._replace(known=known)
    )
    _, body = rule.compose(lost(rule.start()))
    share = rule.accept(body)
    helped, _ = rule.fuse(everything, (share, None))
    assert helped.owed and not helped.near.known[0].any()
    np.testing.assert_array_equal(helped.near.known[1], known[1])
    ignored, _ = rule.fuse(lost(everything), (share, None))
    assert not ignored.owed
    np.testing.assert_array_equal(ignored.near.known, known)


def estimator() -> SelfCheckedFlooding:
    found = build_node(ring(), 0).estimator
    assert isinstance(found, SelfCheckedFlooding)
    return found


def lost(content: Any) -> Any:
    """A node whose records of the newest step are far from its belief."""
    windows = content.windows
    surprise, entries = windows.surprise.copy(), windows.entries.copy()
    surprise[..., -1], entries[..., -1] = 500.0, 4
    windows = windows._replace(surprise=surprise, entries=entries)
    return content._replace(kept=content.kept._replace(windows=windows))
