"""Test the report of `concord agree` on the batched driver."""

import numpy as np
import pytest

from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.studies.near_agreement import departures
from tests.experiments.support import small

SETUP = small(steps=5, schedule="hybrid", occupancy=0.5)
TRACE = read_trace(SETUP, in_memory(SETUP))


def test_the_same_run_departs_nowhere():
    assert departures(SETUP, TRACE) == {}


@pytest.mark.parametrize("name", ["truth", "mean", "cov"])
@pytest.mark.parametrize(("relative", "found"), [(1e-7, True), (1e-13, False)])
def test_what_is_more_than_rounding_is_found(name: str, relative: float, found: bool):
    values = getattr(TRACE, name).copy()
    values[2] += relative * np.abs(values[2]).max()
    changed = departures(SETUP, TRACE._replace(**{name: values}))
    assert set(changed) == ({name} if found else set())
    if found:
        assert changed[name][0][0] == 2


def test_who_sent_and_how_old_it_is_must_be_equal():
    payload, ages = TRACE.payload_bytes.copy(), TRACE.ages.copy()
    payload[3, 1, 2] += 1
    ages[4] += 1
    changed = departures(SETUP, TRACE._replace(payload_bytes=payload, ages=ages))
    assert {name: where[0].tolist()[0] for name, where in changed.items()} == {
        "payload_bytes": 3,
        "ages": 4,
    }


def test_a_missing_number_is_a_departure():
    readings = TRACE.readings.copy()
    readings[np.isnan(readings)] = 0.0
    changed: Trace = TRACE._replace(readings=readings)
    assert set(departures(SETUP, changed)) == {"readings"}
