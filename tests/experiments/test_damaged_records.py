"""Each damage of a recording breaks the promise that speaks of it, and no sound run is blamed.

`test_audit.py` has the commands. Here the arrays of the run are read once for all damages.
"""

from pathlib import Path

import numpy as np
import pytest

from concord.studies.audit import evidence
from concord.studies.audit.again import computed_again
from concord.studies.audit.member_history import member_history_of
from concord.studies.audit.report import audit
from tests.experiments.test_audit import (
    AGAIN,
    MESSAGES,
    RECORDED,
    broken,
    write,
)


@pytest.fixture(scope="module", autouse=True)
def arrays_are_read_once(tmp_path_factory: pytest.TempPathFactory):
    read = evidence.read_dataset
    folder = write(tmp_path_factory.mktemp("sound"), MESSAGES)
    arrays = read(folder / evidence.ARRAYS, evidence._NAMES, "").load()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(evidence, "read_dataset", lambda *_: arrays)
        yield


def test_a_sound_run_keeps_each_promise_and_tells_of_its_events(tmp_path: Path):
    found = audit(write(tmp_path, MESSAGES))
    assert found.broken == 0
    assert all(account.checked > 0 for _, account in found.findings)
    assert [one.event for one in found.around] == ["left 2", "joined 2", "set rounds=2", "loss 0.2"]
    assert [one.step for one in found.around] == [3, 6, 8, 9]
    (join,) = found.joins
    assert (join.step, join.node, join.age_steps) == (6, 2, 0) and join.source in (1, 3)


@pytest.mark.parametrize("name", [name for name, (says, _) in RECORDED.items() if says != AGAIN])
def test_a_damage_breaks_its_promise(tmp_path: Path, name: str):
    says, damaged = RECORDED[name]
    assert any(one.startswith(says) for one in broken(write(tmp_path, damaged())))


@pytest.mark.parametrize("name", [name for name, (says, _) in RECORDED.items() if says == AGAIN])
def test_only_a_computation_again_finds_other_numbers(tmp_path: Path, name: str):
    folder = write(tmp_path, RECORDED[name][1]())
    assert broken(folder) == set()
    # One message differs, in the step that the damage names.
    [difference] = computed_again(folder).differences
    assert difference.endswith("another content")


def test_nees_around_events_are_means_over_the_steps_beside_them(tmp_path: Path):
    with pytest.MonkeyPatch.context() as patched:
        arrays = evidence.read_dataset(Path(), (), "").copy(deep=True)
        nees = arrays["nees"].values[0]
        nees[:] = np.arange(nees.shape[0])[:, None] / 100
        nees[:, 1] = np.nan
        nees[10:] = 1e6
        patched.setattr(evidence, "read_dataset", lambda *_: arrays)
        found = audit(write(tmp_path, MESSAGES)).around
    assert [one.before for one in found] == pytest.approx([0.01, 0.025, 0.035, 0.04])
    assert [one.after for one in found][:3] == pytest.approx([0.04, 0.065, 0.08])
    assert [one.jumps for one in found] == [False, False, False, True]


def test_members_are_those_of_the_events():
    """Rounds of a step change the numbers of later cycles; a node is out between its events."""
    events = [
        (2, {"what": "left", "node": 1}),
        (4, {"what": "settings", "settings": {"rounds": 3}, "first_cycle": 8}),
        (5, {"what": "joined", "node": 1}),
        (7, {"what": "gone", "node": 0}),
    ]
    members = member_history_of(2, events)
    is_in = {node: [members.is_in(node, step) for step in range(9)] for node in (0, 1, 2)}
    assert is_in[0] == [step < 7 for step in range(9)]
    assert is_in[1] == [not 2 <= step < 5 for step in range(9)]
    assert all(is_in[2])
    assert (members.left_at(1, 0), members.left_at(0, 3), members.left_at(2, 0)) == (2, 7, None)
    first = [0, 2, 4, 6, 8, 11, 14, 17, 20]
    for step, cycle in enumerate(first):
        rounds = 2 if step < 4 else 3
        assert list(members.cycles_of(step)) == list(range(cycle, cycle + rounds)), step
        assert {members.step_of(one) for one in members.cycles_of(step)} == {step}
