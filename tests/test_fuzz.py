"""Malformed messages against a network of real processes; `make fuzz` does it with a million."""

import pytest

from benchmarks.fuzz import fuzz
from tests.processes import PROC


@pytest.mark.zenoh
@pytest.mark.skipif(not PROC.is_dir(), reason="reads memory in /proc, which is not there")
def test_malformed_messages_are_all_counted_and_change_no_bit():
    """Nodes, world and recorder each count what was said to them, more than queues hold."""
    outcome = fuzz(9000, seed=3, steps=400)
    assert outcome.refused == outcome.sent
    assert sum(outcome.sent.values()) == 9000
    assert outcome.same_estimates
