"""`concord torture`: what it draws, what it finds, and how it says so."""

import shlex

import msgspec
import pytest

from bus.publication import Slot
from experiments.command_line import main
from experiments.torture import torture
from experiments.torture_case import Case
from experiments.torture_draw import draw_case
from experiments.torture_frames import FRAME_FAULTS, HARMLESS, HostileLink
from experiments.torture_script import SENSOR_FAULTS
from experiments.torture_shrink import replay_command, shrink
from nodes.share import to_frames
from tests.experiments.torture_bugs import BUGS, MOST_SEEDS, Bug, first_found, planted

# Those that are found within one small case, and so in a fast test.
QUICK = {
    "all nodes share the slots of node 0": 2,
    "weights are not renormalised when one is missing": 4,
    "a held share never ages": 3,
}


def bug_of(name: str) -> Bug:
    return next(bug for bug in BUGS if bug.name == name)


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of `concord torture`."""
    with pytest.raises(SystemExit) as end:
        main(["torture", *words])
    told = capsys.readouterr()
    return int(end.value.code or 0), told.out, told.err


def test_nothing_breaks_and_every_fault_is_counted(capsys: pytest.CaptureFixture[str]):
    code, out, _ = said(capsys, "--seeds", "1..11", "--workers", "1", "--json")
    result = msgspec.json.decode(out)
    assert (code, result["failures"], result["cases"]) == (0, [], 11)
    changes = {"kill", "restart", "cut", "heal", "loss", "set"}
    assert changes | {*SENSOR_FAULTS, *FRAME_FAULTS} <= {
        kind for kind, count in result["injected"].items() if count
    }


def test_a_seed_is_a_case_and_its_run_to_the_last_bit():
    assert draw_case(7, {}) == draw_case(7, {})
    assert draw_case(7, {}) != draw_case(8, {})
    assert torture(draw_case(7, {})) == torture(draw_case(7, {}))


def test_what_is_fixed_is_so_and_the_rest_is_drawn():
    drawn, fixed = draw_case(4, {}), draw_case(4, {"nodes": 3, "frame_faults": ("replay 0.5",)})
    assert (fixed.scenario.nodes, fixed.frame_faults) == (3, ("replay 0.5",))
    assert fixed.scenario.seed == drawn.scenario.seed
    assert fixed.calm_step == drawn.calm_step


@pytest.mark.parametrize("name", QUICK)
def test_a_planted_bug_is_found(name: str):
    seed = QUICK[name]
    assert torture(draw_case(seed, {})).broken is None
    with planted(bug_of(name)):
        assert torture(draw_case(seed, {})).broken is not None


@pytest.mark.slow
@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_every_planted_bug_is_found(bug: Bug):
    assert first_found(bug, range(1, MOST_SEEDS + 1)) is not None


def test_a_failure_is_made_smaller_and_its_command_finds_it_again(
    capsys: pytest.CaptureFixture[str],
):
    with planted(bug_of("all nodes share the slots of node 0")):
        code, out, _ = said(capsys, "--seeds", "2", "--workers", "1")
        assert code == 1
        told, again, *_ = out.splitlines()
        assert told.startswith("seed 2: one sender per slot and channel: ")
        words = shlex.split(again.removeprefix("  again: "))
        assert words[:4] == ["concord", "torture", "--seeds", "2"]
        repeated, out, _ = said(capsys, *words[2:])
        assert (repeated, out.splitlines()[0]) == (1, told)
    assert said(capsys, *words[2:])[0] == 0
    assert draw_case(2, {}).scenario.steps > 20
    assert words[words.index("--steps") + 1] == "1"
    assert words[words.index("--nodes") + 1] in "23"


def test_shrinking_keeps_what_matters():
    """An invariant that breaks where a node is killed and frames are repeated."""
    case = draw_case(
        5, {"changes": ("2 kill 1", "3 loss 0.5", "5 restart 1"), "calm_step": 6,
            "frame_faults": ("duplicate 0.5", "delay 0.1")},
    )  # fmt: skip

    def breaks(tried: Case) -> bool:
        killed = any("kill" in line for line in tried.scenario.changes)
        return killed and "duplicate 0.5" in tried.frame_faults and tried.scenario.rounds > 1

    case = msgspec.structs.replace(case, scenario=msgspec.structs.replace(case.scenario, rounds=3))
    small = shrink(case, breaks)
    assert small.scenario.changes == ("2 kill 1",)
    assert small.frame_faults == ("duplicate 0.5",)
    assert (small.scenario.steps, small.scenario.nodes, small.scenario.rule) == (3, 2, "ci")
    assert small.scenario.rounds > 1
    words = shlex.split(replay_command(small))
    assert "2 kill 1" in words and "duplicate 0.5" in words


@pytest.mark.parametrize("kind", FRAME_FAULTS)
def test_faults_of_frames_strike_as_often_as_they_should_and_harmless_ones_lose_nothing(kind: str):
    if kind == "reorder":  # happens to messages that wait, and not on a link
        return
    link = HostileLink(3, {kind: 0.3}, calm=lambda cycle: cycle >= 400)
    frames = [to_frames(b"0123456789", cycle, [Slot(1, 18)])[0] for cycle in range(500)]
    arrived = []
    for frame in frames:
        link(1, 2, frame)  # what another receiver gets is no matter
        arrived.append(list(link(0, 2, frame)))
    assert all(
        got[-1:] == [frame] or kind == "delay"
        for got, frame in zip(arrived[400:], frames[400:], strict=True)
    )
    assert 80 < link.injected[kind] / 2 < 160
    if kind in HARMLESS:
        assert all(frame in got for got, frame in zip(arrived, frames, strict=True))
    elif kind != "corrupt":
        assert any(frame not in got for got, frame in zip(arrived, frames, strict=True))
    struck = [got != [frame] for got, frame in zip(arrived, frames, strict=True)]
    assert any(struck[:400])


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["--seeds", "9..3"], "the lower first"),
        (["--seeds", "some"], "must be a number"),
        (["--seeds", "1", "--rule", "cii"], "did you mean 'ci'"),
        (["--seeds", "1", "--nodes", "many"], "--nodes many"),
        (["--seeds", "1", "--frame-faults", "bite 0.1"], "kinds are vanish"),
        (["--seeds", "1", "--frame-faults", "replay 2"], "must be a kind and a probability"),
        (["--seeds", "1", "--workers", "0"], "must be at least 1"),
    ],
)
def test_a_mistake_is_said_before_anything_runs(
    words: list[str], rule: str, capsys: pytest.CaptureFixture[str]
):
    code, out, err = said(capsys, *words)
    assert (code, out) == (2, "")
    assert rule in err
    assert "Traceback" not in err
