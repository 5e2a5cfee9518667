"""Hosts that do not withdraw: a share of several frames goes frame by frame, up to pLatestTx.

On `flexray-adapter` a share of the oscillator takes five frames of 16 bytes, each of 7 minislots.
Four shares take 140 of the 163 minislots. Frames of the next share begin in minislots 141, 148 and
155. No frame begins after minislot 157.
"""

from typing import Any

import numpy as np
import pytest

from concord.bus.flexray.frame import decode
from concord.bus.flexray.presets import FLEXRAY_ADAPTER
from concord.bus.longest_wait import LongestWait
from concord.features.flexray_tools.commands.rehearsal import rehearse
from concord.results.bus.bus_capture import capture
from concord.results.bus.bus_report import figures_of, lines
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import Trace, read_trace
from concord.runtime.batched.build import build_network
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate

NODES, WHOLE, CUT_FRAMES, FRAMES = 7, 4, 3, 5


def setup_of(**options: Any) -> Setup:
    asked = {
        "nodes": NODES, "graph": "complete", "steps": 4, "schedule": "dynamic",
        "arbiter": "minislot", "cluster": "flexray-adapter", "withdrawal": False, **options,
    }  # fmt: skip
    return prepare(scenario_of("oscillator", **asked))


def trace_of(setup: Setup) -> Trace:
    return read_trace(setup, in_memory(setup))


def test_the_first_share_that_does_not_fit_is_cut_and_never_used():
    setup = setup_of()
    trace = trace_of(setup)
    assert trace.published.all(axis=(0, 1)).tolist() == [True] * WHOLE + [False] * 3
    assert not trace.published[..., WHOLE:].any()
    assert trace.cut[..., WHOLE].all() and trace.cut.sum() == trace.cut[..., WHOLE].sum()
    others = np.delete(np.arange(NODES), WHOLE)
    assert (trace.ages[:, others, WHOLE] == -1).all()
    cycles = trace.cut[..., WHOLE].size
    counters = trace.counters[WHOLE]
    assert (counters["cut"], counters["sent"]) == (cycles, CUT_FRAMES * cycles)
    assert {count.get("heard") for count in trace.counters[WHOLE:]} == {WHOLE * cycles}


def test_the_capture_shows_the_frames_of_a_cut_share():
    setup = setup_of()
    messages = list(in_memory(setup))
    trace = read_trace(setup, messages)
    captured = capture(setup, trace, messages)
    assert captured is not None
    per_cycle = WHOLE * FRAMES + CUT_FRAMES
    first = FLEXRAY_ADAPTER.first_dynamic_id
    bus = build_bus(setup)
    assert len(captured) == trace.cut[..., 0].size * per_cycle
    for cycle in range(trace.cut[..., 0].size):
        frames = captured[cycle * per_cycle : (cycle + 1) * per_cycle]
        assert [decode(one.data).frame_id for one in frames] == list(
            range(first, first + per_cycle)
        )
        begins = [one.time_us - bus.timebase.begins_us(cycle) for one in frames]
        expected = [FLEXRAY_ADAPTER.minislot_start_us(1 + 7 * place) for place in range(per_cycle)]
        np.testing.assert_allclose(
            np.diff(begins), np.diff(expected), atol=1e-6, err_msg="a frame each 7 minislots"
        )


def test_of_equal_shares_withdrawal_changes_load_and_nothing_else():
    cut, withdrawn = setup_of(), setup_of(withdrawal=True)
    one, other = trace_of(cut), trace_of(withdrawn)
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.cov, other.cov)
    np.testing.assert_array_equal(one.published, other.published)
    pairs = ((cut, one), (withdrawn, other))
    figures, without = (figures_of(runs_of_trace(*pair)) for pair in pairs)
    assert figures is not None and without is not None
    assert figures.cut_shares == one.cut.sum() and without.cut_shares == 0
    ratio = (WHOLE * FRAMES + CUT_FRAMES) / (WHOLE * FRAMES)
    assert figures.frames == ratio * without.frames
    assert figures.delay_us_max == without.delay_us_max
    assert figures.starved == without.starved == [4, 5, 6]
    assert f"cut: of {figures.cut_shares} shares only the first frames" in "\n".join(lines(figures))


@pytest.mark.parametrize("arbiter", ["minislot", "urgency"])
def test_the_rehearsal_cuts_as_the_run_does(arbiter: str):
    setup = setup_of(arbiter=arbiter, steps=6)
    rehearsal = rehearse(setup, build_bus(setup), 6)  # type: ignore[arg-type]
    assert rehearsal.sent.cut is not None and rehearsal.sent.cut.any()
    if arbiter == "minislot":
        trace = trace_of(setup)
        np.testing.assert_array_equal(rehearsal.sent.cut, trace.cut)
        np.testing.assert_array_equal(rehearsal.sent.payload_bytes, trace.payload_bytes)


def test_urgency_serves_every_contender_within_its_bound():
    """With two classes, node by node, an old contender waits as long as the bound at most."""
    setup = setup_of(arbiter="urgency", urgency_classes=2, steps=30)
    bus, trace = build_bus(setup), trace_of(setup)
    wait = bus.longest_wait  # type: ignore[attr-defined]
    assert isinstance(wait, LongestWait) and trace.cut.any()
    sent = trace.published.reshape(-1, NODES)
    for node in range(NODES):
        turns = np.flatnonzero(sent[:, node]).tolist()
        gaps = np.diff(np.array([-1, *turns, len(sent)]))
        assert gaps.max() <= wait.first_cycles


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"arbiter": "wtod"}, "--no-withdrawal --arbiter wtod: an ideal arbiter awards whole"),
        ({"schedule": "full", "arbiter": None, "cluster": "fitted"}, "no node contends"),
        ({"rule": "labelled", "relay": True}, "--no-withdrawal --relay: with --relay a host"),
    ],
)
def test_what_no_controller_could_send_is_refused(options: dict[str, Any], words: str):
    asked = {key: value for key, value in options.items() if value is not None}
    base = {"arbiter": "minislot"} if options.get("arbiter", "") == "" else {}
    scenario = {"nodes": NODES, "graph": "complete", "schedule": "dynamic", "withdrawal": False}
    with pytest.raises(ValueError, match=words):
        prepare(scenario_of("oscillator", **{**scenario, **base, **asked}))


def test_cut_shares_have_no_array_form_and_many_runs_go_by_messages():
    setup = setup_of()
    with pytest.raises(ValueError, match=r"a share that is cut \(--no-withdrawal\)"):
        build_network(setup, range(2))
    histories, trace = simulate(setup, range(2)), trace_of(setup)
    np.testing.assert_array_equal(histories.mean[0], trace.mean)
    np.testing.assert_array_equal(histories.payload_bytes[0], trace.payload_bytes)
