"""Bounds on what better knowledge gives `labelled` where a bus is scarce and lossy.

A sender that knows all sets of its neighbours sends at least as many combinations of records as the
neediest neighbour lacks. Without a code it sends each record that some neighbour lacks. The ratio
bounds what coded relaying can save (Bar-Yossef, Birk, Jayram, Kol, 2011).

A network whose senders know all sets of their neighbours bounds what better digests can give. More
and shorter shares give as much, in less of the bus.
"""

from typing import Any

import numpy as np
import pytest

from concord.nodes.lanes.labelled import BatchedFlooding
from concord.nodes.lanes.links import neighbourhoods
from concord.results.figures.summary import Summary, summarise
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.studies.monte_carlo.simulate import simulate

pytestmark = pytest.mark.slow

LOSSY: dict[str, Any] = {
    "nodes": 20, "rule": "labelled", "schedule": "dynamic", "occupancy": 0.1, "relay": True,
    "loss": 0.3, "steps": 60, "seed": 2121,
}  # fmt: skip
# The command of docs/labelled.md, "More and shorter shares".
SHORT: dict[str, Any] = {
    "occupancy": 0.2, "record_number": "int12", "digest_steps": 2, "repeat_bytes": 6,
    "withhold_below": 0.03,
}  # fmt: skip


def test_an_ideal_code_would_save_little(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = BatchedFlooding._composed
    sent = useful = coded = left_out = 0

    def counting(self: Any, content: Any, runs: np.ndarray, nodes: np.ndarray) -> Any:
        nonlocal sent, useful, coded, left_out
        after = usual(self, content, runs, nodes)
        records = after[1].records
        untold = np.bitwise_or.reduce(self._doubts(content, runs, nodes)[:, :, 0], axis=1)
        left_out += np.bitwise_count(untold & ~records).sum()
        sent += np.bitwise_count(records).sum()
        for run, node, share in zip(runs, nodes, records, strict=True):
            place = neighbourhoods(self.links)
            near = self.links.sender[place.links[node][place.real[node]]]
            lacked = share & ~content.kept.held[run, near]
            useful += np.bitwise_count(np.bitwise_or.reduce(lacked, axis=0)).sum()
            coded += np.bitwise_count(lacked).sum(axis=(1, 2)).max()
        return after

    monkeypatch.setattr(BatchedFlooding, "_composed", counting)
    simulate(prepare(scenario_of("target-tracking", **LOSSY)), range(5), keep=())
    # The runs gave 23036, 16996, 16235 and 11; rounding may move them a little.
    assert 0.9 * useful < coded <= useful
    assert 0.6 * sent < useful < 0.85 * sent
    # Frames are scarce and not bytes: shares hold nearly every record that is due.
    assert left_out < 0.02 * sent


@pytest.mark.study
def test_perfect_knowledge_of_neighbours_leaves_most_of_the_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = _error(LOSSY)
    lossless = _error({**LOSSY, "loss": 0.0})

    def known(self: Any, content: Any, runs: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        near, held = neighbourhoods(self.links), content.kept.held
        lacked = (
            held[runs, nodes][:, None] & ~held[runs[:, None], self.links.sender[near.links[nodes]]]
        )
        doubts = np.zeros((*lacked.shape[:2], self.choice.levels, *lacked.shape[2:]), np.uint8)
        doubts[:, :, 0] = np.where(near.real[nodes][..., None, None], lacked, np.uint8(0))
        return doubts

    monkeypatch.setattr(BatchedFlooding, "_doubts", known)
    assert lossless < _error(LOSSY) < usual


@pytest.mark.study
def test_more_and_shorter_shares_err_less_in_less_of_the_bus() -> None:
    usual, short = _figures(LOSSY), _figures({**LOSSY, **SHORT})
    brief, long = short.figures, usual.figures
    assert brief["to_centralised"].value < 1.4
    assert brief["to_centralised"].high < long["to_centralised"].low
    assert brief["bytes_per_step"].high < 500 < long["bytes_per_step"].low
    assert brief["bus_load"].high < long["bus_load"].low < 0.1
    worst = max(node["anees"].value for node in short.nodes)
    assert worst < short.value("anees_centralised") + 0.1


def _figures(options: dict[str, Any]) -> Summary:
    setup = prepare(scenario_of("target-tracking", **options))
    return summarise(simulate(setup, range(10)))


def _error(options: dict[str, Any]) -> float:
    """RMSE of the estimates from step 20 on."""
    histories = simulate(prepare(scenario_of("target-tracking", **options)), range(5), keep=())
    errors = histories.mean[:, 20:] - histories.truth[:, 20:, None]
    return float(np.sqrt((errors[..., [0, 2]] ** 2).sum(-1).mean()))
