"""A log without a satellite receiver: its node sends nothing, owns no slot, and still estimates."""

from pathlib import Path

import numpy as np
import pytest

from concord.bus.schedule import full_publish, hybrid
from concord.features.vehicle.plant.drive_log import write_drive
from concord.results.bus.bus_report import figures_of
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario
from tests.features.vehicle.identification.simulated_log import TRUE, simulated_log
from tests.test_batched_agreement import check_agreement

SATELLITES = 3


@pytest.fixture
def log(tmp_path: Path) -> str:
    write_drive(tmp_path, simulated_log(TRUE, 0.6, 1)[0], TRUE)
    return str(tmp_path)


def of_log(data: str, **options):
    return scenario("vehicle-network", data=data, steps=12, filter="ukf", **options)


@pytest.mark.parametrize(("rule", "cluster", "frames"), [("ci", "audi", 9), ("hcmci", "fitted", 2)])
def test_its_node_sends_nothing_and_the_bus_is_freer(
    log: str, rule: str, cluster: str, frames: int
):
    setup = prepare(of_log(log, rule=rule, cluster=cluster))
    trace = read_trace(setup, in_memory(setup))
    assert [one.get("sent", 0) > 0 for one in trace.counters] == [True, True, True, False]
    assert all(one.get("missed", 0) == 0 for one in trace.counters)
    figures = figures_of(runs_of_trace(setup, trace))
    assert figures is not None
    # As many frames for each of three nodes as for each of four.
    assert figures.frames_per_cycle_mean == 3 * frames
    # It hears the others, so it knows the speed as they do.
    assert abs(trace.mean[-1, SATELLITES, 2] - trace.mean[-1, 0, 2]) < 0.1


def test_drivers_agree(log: str):
    check_agreement(of_log(log), (0,))


def test_a_node_that_relays_for_others_keeps_its_slot(log: str):
    """Where not all hear all, information passes through the node without data."""
    setup = prepare(of_log(log, graph="ring"))
    assert build_bus(setup).schedule.static_senders(0) == (0, 1, 2, 3)
    whole = prepare(of_log(log))
    assert build_bus(whole).schedule.static_senders(0) == (0, 1, 2)


def test_a_column_of_the_sensor_gives_the_slot_back(log: str):
    columns = Path(log) / "columns.toml"
    text = columns.read_text() + 'ground_speed = { column = "speed", unit = "m/s" }\n'
    columns.write_text(text)
    setup = prepare(of_log(log))
    assert build_bus(setup).schedule.static_senders(0) == (0, 1, 2, 3)


def test_a_schedule_of_some_nodes_is_that_of_fewer_under_their_numbers():
    some = hybrid(3, 0.7).of_nodes((0, 2, 5), 6)
    few = hybrid(3, 0.7)
    names = np.array([0, 2, 5])
    for cycle in range(2 * few.period):
        assert some.static_senders(cycle) == tuple(names[list(few.static_senders(cycle))])
        assert some.contenders(cycle) == tuple(names[list(few.contenders(cycle))])
        assert some.dynamic_slots(cycle) == few.dynamic_slots(cycle)
    assert full_publish(2).of_nodes((1, 3), 4).static_senders(7) == (1, 3)
