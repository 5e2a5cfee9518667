"""How labelled records spread in many runs, from the steps of the batched driver."""

import numpy as np

from concord.results.records.record_spread import NEVER, RecordSpread
from concord.runtime.batched.driver import Instant
from concord.scenarios.setup import Setup


class SpreadHistory:
    """Takes the steps of R runs of a rule with records, one after the other."""

    def __init__(self, setup: Setup, runs: int) -> None:
        steps, nodes = setup.scenario.steps, setup.scenario.nodes
        self._taken = np.zeros((runs, steps, nodes), dtype=bool)
        self._arrival = np.full((runs, nodes, steps, nodes), NEVER)
        self._body_bytes = np.zeros((runs, steps), dtype=np.int64)
        # Of each run: shares, checkpoints, records.
        self._sent = np.zeros((3, runs), dtype=np.int64)
        self._window_steps = 0

    def add(self, instant: Instant) -> None:
        """One step more."""
        spread, step = instant.spread, instant.step
        assert spread is not None, "the rule has records"
        self._window_steps = window_steps = spread.held.shape[2]
        self._taken[:, step] = ~np.isnan(instant.readings).all(axis=(2, 3))
        first = max(step + 1 - window_steps, 0)
        held = spread.held[:, :, -(step + 1 - first) :]
        arrived = self._arrival[:, :, first : step + 1]
        arrived[held & (arrived == NEVER)] = step
        # Whatever its source refuses to tell, it has.
        own = np.arange(held.shape[-1])
        self._arrival[:, own, step, own] = np.where(self._taken[:, step], step, NEVER)
        self._body_bytes[:, step] = spread.body_bytes.sum(axis=(0, 2))
        said = (instant.payload_bytes > 0, spread.checkpoints, spread.records)
        self._sent += [one.sum(axis=(0, 2)) for one in said]

    def of_runs(self) -> tuple[RecordSpread, ...]:
        """Of each run, after its last step."""
        return tuple(
            RecordSpread(taken, arrival, self._window_steps, body_bytes, *sent)
            for taken, arrival, body_bytes, sent in zip(
                self._taken, self._arrival, self._body_bytes, self._sent.T.tolist(), strict=True
            )
        )
