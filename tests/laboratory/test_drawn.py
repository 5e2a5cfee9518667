"""Drawn cases: what the laboratory draws, what it finds, and how it says so."""

import shlex
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from concord.bus.flexray.publication import Slot
from concord.bus.flexray.share_frames import SHARE_FRAMES, to_frames
from concord.experiments.cli.command_line import main
from concord.nodes.faults.vocabulary import EVERY_FAULT
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from concord.scenarios.script import script_of
from concord.studies.check.shrinking import shrink
from tests.experiments.command_support import Said
from tests.experiments.support import scenario
from tests.laboratory.broken import Broken
from tests.laboratory.bugs import BUGS, FOUND, Bug, first_found, planted
from tests.laboratory.case import (
    SimulationCase,
    draw_case,
    replay_command,
    run_command,
    smaller_cases,
)
from tests.laboratory.case_run import run_case
from tests.laboratory.promises import brings_back, liars_of
from tests.laboratory.script import WORDS, calm_from, is_harmless
from tests.laboratory.sound import SOUND, Sound
from tests.laboratory.verdict import EstimateHistory, check_consistency
from tests.laboratory.wire import LOSING, WIRE_FAULTS, Wire

pytestmark = pytest.mark.slow
Laboratory = Callable[..., Said]
QUICKLY_FOUND = (
    "a share is used in every part of its cycle",
    "the checksum of a frame that is due is not checked",
    "a covariance is not quite symmetric",
    "a channel that loses some frames loses all",
)


def bug_of(name: str) -> Bug:
    return next(bug for bug in BUGS if bug.name == name)


def test_nothing_breaks_and_what_was_done_is_counted(laboratory: Laboratory):
    wire = ("--wire", "vanish 0.1, garbage 0.3, shuffle 0.3")
    small = ("--nodes", "4", "--steps", "20", "--workers", "1", "--json")
    code, out, _ = laboratory("drawn", "--seeds", "1..4", *wire, *small)
    result = msgspec.json.decode(out)
    assert (code, result["failures"], result["cases"]) == (0, [], 4)
    assert {*WIRE_FAULTS} <= {kind for kind, count in result["injected"].items() if count}
    assert {*result["struck"]} <= {*EVERY_FAULT} and min(result["struck"].values()) > 0


def test_the_help_names_no_default_of_a_field_that_is_drawn(laboratory: Laboratory):
    code, out, _ = laboratory("drawn", "--help")
    assert code == 0 and "drawn from the seed" in out
    assert "for target-tracking)" not in out


def test_the_whole_vocabulary_is_drawn():
    """Every word that there is, and so also one that is new in the table."""
    cases = [draw_case(seed, {}) for seed in range(1, 81)]
    lines = [line for case in cases for line in case.scenario.changes]
    words = {line.split()[1] for line in lines}
    assert words == {*WORDS, "calm"} and {*EVERY_FAULT} < words
    settings = {line.split()[2].split("=")[0] for line in lines if " set " in line}
    assert settings >= {"graph", "placement", "rule", "rounds", "schedule"}
    assert {word.split()[0] for case in cases for word in case.wire} == {*WIRE_FAULTS}
    # Some cases are harmless and some have liars, so the promises on both are tested.
    harmless = [case for case in cases if is_harmless(case.scenario)]
    liars = [case for case in cases if liars_of(case.scenario)]
    assert len(harmless) > 5 and len(liars) > 5
    assert {case.scenario.rule.name for case in liars} > {"trimmed-ci"}


@pytest.mark.parametrize(
    ("lines", "calm_step"),
    [
        ((), 20),
        (("3 corrupt 0.1", "8 calm"), 8),
        (("3 corrupt 0.1", "8 calm", "9 set rounds=1"), 8),
        (("3 corrupt 0.1", "8 calm", "8 cut 0 1"), 20),
        (("3 kill 1", "8 calm"), 20),
        (("3 kill 1", "8 restart 1", "8 calm"), 8),
        (("8 calm", "9 partition 0"), 20),
        (("8 calm", "9 loss 0.1"), 20),
    ],
)
def test_calm_begins_when_nothing_is_wrong_any_more(lines: tuple[str, ...], calm_step: int):
    case = draw_case(1, {"changes": lines, "steps": 20, "nodes": 4})
    assert calm_from(script_of(case.scenario), 20) == calm_step


@pytest.mark.parametrize(
    ("lines", "harmless"),
    [
        (("1 duplicate 0.3", "2 set rounds=2", "5 calm"), True),
        (("1 guardian 1", "2 babble 1 0.5"), True),
        (("2 babble 1 0.5",), False),
        (("2 babble 1 0.5", "2 guardian 1"), False),
        (("1 guardian 1", "2 babble 1 0.5", "3 guardian 0"), False),
        (("1 guardian 1", "2 babble 1 0.5", "3 set schedule=round-robin occupancy=0.5"), True),
        (("1 guardian 1", "2 babble 1 0.5", "3 set schedule=hybrid occupancy=0.5"), False),
        (("1 channel A 1", "2 channel A 0.5"), True),
        (("1 channel A 1", "2 channel B 0.5"), False),
        (("1 spoof 0 1 0.5", "2 corrupt 0.1"), False),
        (("1 replay 0 0.5 2", "2 cut 0 1"), False),
    ],
)
def test_what_can_do_no_harm_is_known_from_its_words(lines: tuple[str, ...], harmless: bool):
    fixed = {"changes": lines, "nodes": 4, "graph": "ring", "cluster": "fitted-ab"}
    fixed |= {
        "rule": "ci",
        "scenario": "oscillator",
        "control": "open",
        "schedule": "full",
        "channels": "all",
    }
    assert is_harmless(draw_case(1, fixed).scenario) == harmless


def test_who_lies_is_forgiven_where_the_rule_expects_so_many_liars():
    def back(rule: str, *lines: str, graph: str = "complete") -> bool:
        fixed = {"nodes": 6, "graph": graph, "rule": rule, "liars": 1, "hold": "decayed"}
        fixed |= {"scenario": "oscillator", "control": "open", "links": "static", "changes": lines}
        return brings_back(prepare(draw_case(1, fixed).scenario))

    assert back("ci") and back("trimmed-ci") and not back("trimmed-ci", graph="ring")
    assert not back("ci", "2 lie 1 3 2") and back("trimmed-ci", "2 lie 1 3 2")
    assert back("ci", "2 lie 1 0 2")
    assert not back("trimmed-ci", "2 lie 1 3 2", "3 lie 2 3 2")
    assert not back("trimmed-ci", "2 lie 1 3 2", "3 set rule=ci")


def test_a_seed_is_a_case_and_its_run_to_the_last_bit():
    assert draw_case(7, {}) == draw_case(7, {})
    assert draw_case(7, {}) != draw_case(8, {})
    assert run_case(draw_case(7, {})) == run_case(draw_case(7, {}))


def test_what_is_fixed_is_so_and_the_rest_is_drawn():
    drawn, fixed = draw_case(4, {}), draw_case(4, {"nodes": 3, "wire": ("garbage 0.5",)})
    assert (fixed.scenario.nodes, fixed.wire) == (3, ("garbage 0.5",))
    assert fixed.scenario.seed == drawn.scenario.seed
    assert fixed.calm_step == drawn.calm_step < drawn.scenario.steps


def test_a_network_that_believes_too_much_where_its_filter_does_not_is_found():
    setup = prepare(scenario("target-tracking", nodes=4, steps=12, stretch=100.0))
    trace = read_trace(setup, in_memory(setup))
    heard = np.ones(trace.mean.shape[:2], dtype=bool)
    run = EstimateHistory(
        setup, trace.truth, trace.mean, trace.cov, trace.readings, None, heard, 0 * heard
    )
    check_consistency(run)
    with pytest.raises(Broken, match="errors are as believed"):
        check_consistency(run._replace(cov=1e-3 * run.cov))


@pytest.mark.parametrize("sound", SOUND[::6], ids=lambda sound: sound.reason)
def test_a_sound_network_is_not_complained_of(sound: Sound):
    """`python -m tests.laboratory bugs` tries all of them."""
    assert run_case(draw_case(sound.seed, sound.fixed)).broken is None


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_a_bug_can_be_planted(bug: Bug):
    """A rewrite of the function, in which the bug's text is missing, fails here."""
    with planted(bug):
        pass


@pytest.mark.parametrize("name", QUICKLY_FOUND)
def test_a_planted_bug_is_found(name: str):
    """One for each kind of promise; `python -m tests.laboratory bugs` plants all of them."""
    found = first_found(bug_of(name), [FOUND[name]])
    assert found is not None
    assert run_case(draw_case(found.seed, {})).broken is None


def test_a_failure_is_made_smaller_and_its_command_finds_it_again(
    laboratory: Laboratory, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    with planted(bug_of("all nodes share the slots of node 0")):
        code, out, _ = laboratory("drawn", "--seeds", "2", "--workers", "1")
        assert code == 1
        told, again, look, *_ = out.splitlines()
        assert told.startswith("seed 2: one sender per slot and channel: ")
        words = shlex.split(again.removeprefix("  again: "))
        assert words[:6] == ["python", "-m", "tests.laboratory", "drawn", "--seeds", "2"]
        repeated, out, _ = laboratory("drawn", *words[4:])
        assert (repeated, out.splitlines()[0]) == (1, told)
    ordinary = shlex.split(look.removeprefix("  to look at: "))
    assert ordinary[:3] == ["concord", "run", "--scenario"]
    main([*ordinary[1:], "--out", str(tmp_path / "run"), "--json"])
    assert msgspec.json.decode(capsys.readouterr().out)["steps"] == 1
    assert laboratory("drawn", *words[4:])[0] == 0
    assert draw_case(2, {}).scenario.steps > 20
    assert words[words.index("--steps") + 1] == "1"
    assert words[words.index("--nodes") + 1] in "23"


def test_shrinking_keeps_what_matters():
    """An invariant that breaks where a node is killed and garbage comes."""
    case = draw_case(
        5, {"changes": ("2 kill 1", "3 loss 0.5", "5 restart 1", "6 calm"),
            "wire": ("garbage 0.5", "vanish 0.1")},
    )  # fmt: skip

    def breaks(tried: SimulationCase) -> bool:
        killed = any("kill" in line for line in tried.scenario.changes)
        return killed and "garbage 0.5" in tried.wire and tried.scenario.rounds > 1

    case = msgspec.structs.replace(case, scenario=msgspec.structs.replace(case.scenario, rounds=3))
    small = shrink(case, smaller_cases, breaks)
    assert small.scenario.changes == ("2 kill 1",)
    assert small.wire == ("garbage 0.5",)
    assert (small.scenario.steps, small.scenario.nodes, small.scenario.rule.name) == (3, 2, "ci")
    assert small.scenario.rounds > 1
    words = shlex.split(replay_command(small))
    assert "2 kill 1" in words and "garbage 0.5" in words
    assert "2 kill 1" in shlex.split(run_command(small))


def test_shrinking_passes_over_values_that_a_rule_does_not_know():
    """A rule of sets has no hold policy of that name."""
    case = draw_case(700134, {})
    assert case.scenario.rule.name == "ellipsoid"
    small = shrink(case, smaller_cases, lambda tried: tried.scenario.rule.name == "ellipsoid")
    assert (small.scenario.steps, small.wire, small.scenario.changes) == (1, (), ())


@pytest.mark.parametrize("kind", WIRE_FAULTS)
def test_the_wire_strikes_as_often_as_it_should_until_calm(kind: str):
    if kind == "shuffle":  # happens to messages that wait, and not on a link
        wire = Wire(3, {kind: 0.3}, calm=lambda _: False, frame_format=SHARE_FRAMES)
        picked = [wire.pick(10) for _ in range(500)]
        assert min(picked) == 0 and max(picked) == 9
        assert 80 < wire.injected[kind] < 180
        return
    wire = Wire(3, {kind: 0.3}, calm=lambda cycle: cycle >= 400, frame_format=SHARE_FRAMES)
    frames = [to_frames(b"0123456789", cycle, [Slot(1, 18)])[0] for cycle in range(500)]
    arrived = []
    for frame in frames:
        wire.carry(1, 2, frame)  # the frames of another receiver do not count
        arrived.append(list(wire.carry(0, 2, frame)))
    pairs = list(zip(arrived, frames, strict=True))
    assert all(got == [frame] for got, frame in pairs[400:])
    assert 80 < wire.injected[kind] / 2 < 160
    assert any(got != [frame] for got, frame in pairs[:400])
    assert all(frame in got for got, frame in pairs) == (kind not in LOSING)


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["--seeds", "9..3"], "the lower first"),
        (["--seeds", "some"], "must be a number"),
        (["--seeds", "1", "--rule", "cii"], "did you mean 'ci'"),
        (["--seeds", "1", "--nodes", "many"], "--nodes many"),
        (["--seeds", "1", "--wire", "replay 0.1"], "all other faults are words of --changes"),
        (["--seeds", "1", "--wire", "garbage 2"], "must be a kind and a probability"),
        (["--seeds", "1", "--workers", "0"], "must be at least 1"),
    ],
)
def test_a_mistake_is_said_before_anything_runs(
    words: list[str], rule: str, laboratory: Laboratory
):
    code, out, err = laboratory("drawn", *words)
    assert (code, out) == (2, "")
    assert rule in err
    assert "Traceback" not in err
