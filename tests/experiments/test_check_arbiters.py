"""The promises of arbiters: those of concord hold, and each planted mistake is found."""

import itertools

import numpy as np
import pytest

from concord.bus.arbitration import ARBITERS, Arbiter, lowest_frame_id
from concord.experiments.__main__ import main
from concord.studies.check.arbiter_promises import (
    ARBITER_PROMISES,
    CheckedArbiter,
    checked_arbiter,
)

CASES = range(1, 41)
PROMISES = {promise.name: promise for promise in ARBITER_PROMISES}
CALLS = itertools.count()


def planted(urgency) -> CheckedArbiter:
    return checked_arbiter("wtod")._replace(arbiter=Arbiter(urgency))


@pytest.mark.parametrize("name", ARBITERS)
def test_arbiters_of_concord_keep_their_promises(name: str):
    checked = checked_arbiter(name)
    found = {
        promise.name: promise.check(checked, CASES).status
        for promise in ARBITER_PROMISES
        if promise.name != "agreement"
    }
    # Of equal bids the lowest frame ID comes first; urgency classes are those of the bus.
    starvation = {"wtod": "note", "minislot": "note", "urgency": "skipped", "round-robin": "holds"}
    assert found.pop("starvation") in {starvation.get(name, other) for other in ("holds", "note")}
    assert set(found.values()) == {"holds"}, found


def mixes_runs(state, bids, frame_ids):
    return bids * (bids.max() % 2 * 2 - 1)


def by_place(state, bids, frame_ids):
    return np.broadcast_to(np.arange(bids.shape[-1]), bids.shape)


def remembers(state, bids, frame_ids):
    return np.broadcast_to(frame_ids * (1 if next(CALLS) % 3 else -1), bids.shape)


def changes_bids(state, bids, frame_ids):
    bids[...] = 7
    return frame_ids


def fails(state, bids, frame_ids):
    raise ZeroDivisionError("no urgency")


@pytest.mark.parametrize(
    ("promise", "urgency"),
    [
        ("lanes", mixes_runs),
        ("order", by_place),
        ("memory", remembers),
        ("memory", changes_bids),
        ("slots", fails),
    ],
)
def test_a_planted_mistake_is_found(promise: str, urgency):
    result = PROMISES[promise].check(planted(urgency), CASES)
    assert result.status == "BROKEN" and result.case in CASES
    assert PROMISES[promise].check(planted(lowest_frame_id), CASES).status == "holds"


def test_the_command_knows_an_arbiter_by_its_three_arguments(tmp_path, capsys):
    file = tmp_path / "patient.py"
    file.write_text("def longest_wait(state, bids, frame_ids):\n    return -state.waits\n")
    with pytest.raises(SystemExit) as ended:
        main(["check", f"{file}:longest_wait", "--cases", "5", "--promise", "starvation"])
    assert ended.value.code == 0
    assert "wins of 40 equal contests: [8, 8, 8, 8, 8]" in capsys.readouterr().out
