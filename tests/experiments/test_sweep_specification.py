"""Test the specification of a sweep: from comma lists to cells, and the refusals."""

import numpy as np
import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st

from concord.experiments.scenario_flags import FieldOptions, said_in
from concord.scenarios.catalogue import definitions
from concord.scenarios.types.assignment import flat
from concord.studies.sweep.cells import checked_cells, difference
from concord.studies.sweep.specification import FIELDS, Range, cells_of, specify


def test_every_combination_in_order_the_last_field_fastest():
    cells = cells_of(specify({"nodes": "9", "graph": "ring,path", "rule": "ci,wac"}))
    names = [cell.name for cell in cells]
    assert names == [
        "graph=ring, rule=ci", "graph=ring, rule=wac",
        "graph=path, rule=ci", "graph=path, rule=wac",
    ]  # fmt: skip
    assert [cell.number for cell in cells] == [0, 1, 2, 3]
    assert all(cell.scenario.nodes == 9 for cell in cells)


def test_a_part_of_the_bus_asks_for_a_schedule_as_in_a_run():
    schedules = {
        cell.values["occupancy"]: cell.scenario.bus.schedule.name
        for cell in cells_of(specify({"occupancy": "1,.5"}))
    }
    assert schedules == {1.0: "full", 0.5: "dynamic"}


def test_what_becomes_of_the_network_is_swept_with_semicolons_between_changes():
    cells = cells_of(specify({"changes": "none,3 kill 1;5 restart 1,4 loss 0.2"}))
    changes = [cell.scenario.changes for cell in cells]
    assert changes == [(), ("3 kill 1", "5 restart 1"), ("4 loss 0.2",)]


def test_every_field_of_a_scenario_can_be_swept():
    for definition in definitions().values():
        assert {*flat(definition.defaults)} - {"run"} <= {*FIELDS}
    words = "--rounds 1,2 --relay true,false --window-steps none,3"
    specification = specify(said_in(tyro.cli(FieldOptions, args=words.split())))
    assert specification.levels == {
        "rounds": [1, 2], "relay": [True, False], "window_steps": [None, 3],
    }  # fmt: skip


def test_whole_ranges_are_lists_and_others_need_a_hypercube():
    assert specify({"seed": "3..5"}).levels == {"seed": [3, 4, 5]}
    swept = specify({"seed": "3..5", "occupancy": "0.1..1"}, samples=8)
    assert swept.ranges == {"seed": Range(3, 5, True), "occupancy": Range(0.1, 1.0, False)}
    with pytest.raises(ValueError, match="needs --latin-hypercube"):
        specify({"occupancy": "0.1..1"})


@given(samples=st.integers(2, 30), seed=st.integers(0, 1000))
def test_a_latin_hypercube_has_one_cell_in_each_slice(samples: int, seed: int):
    asked = {"occupancy": "0.2..1", "decay": "0..1", "seed": str(seed), "graph": "ring,path"}
    cells = cells_of(specify(asked, samples=samples))
    assert len(cells) == samples
    for field, low in (("occupancy", 0.2), ("decay", 0.0)):
        places = np.array([float(cell.values[field]) for cell in cells])  # type: ignore[arg-type]
        # Values are rounded to six digits: the edges of the slices with them.
        slices = np.floor((places - low) / (1 - low) * samples - 1e-4).clip(0).astype(int)
        assert len(np.unique(slices)) >= samples - 1
    rings = sum(cell.values["graph"] == "ring" for cell in cells)
    assert abs(rings - samples / 2) <= 1


REFUSED = [
    ({"rulee": "ci"}, "did you mean 'rule'"),
    ({"rounds": "1,x"}, "--rounds x: must be a whole number"),
    ({"occupancy": "1,a"}, "--occupancy a: must be a number"),
    ({"relay": "maybe"}, "must be true or false"),
    ({"rule": "ci,wac,ci"}, "ci is there twice"),
    ({"rule": "ci,,wac"}, "a value is empty"),
    ({"rounds": "5..2"}, "must go upwards"),
]


@pytest.mark.parametrize(("asked", "says"), REFUSED)
def test_what_no_field_can_be_is_refused(asked: dict[str, str], says: str):
    with pytest.raises(ValueError, match=says):
        specify(asked)


@pytest.mark.parametrize("numbers", [{"runs": 0}, {"samples": 1}])
def test_numbers_out_of_range_are_refused(numbers: dict[str, int]):
    with pytest.raises(ValueError, match="must be"):
        specify({"graph": "ring,path"}, **numbers)  # type: ignore[arg-type]


BAD_CELLS = [
    ({"graph": "ring,rnig"}, "cell graph=rnig .2 of 2.: unknown graph 'rnig': did you mean 'ring'"),
    ({"rule": "ci,centralised", "graph": "ring"}, "cell rule=centralised .*must hear all"),
    ({"scenario": "target-tracking,target-traking"}, "did you mean 'target-tracking'"),
    ({"rule": "ci,icf", "weights": "metropolis,equal-neighbour"}, "weights=equal-neighbour"),
    ({"occupancy": ".5,1", "schedule": "full"}, "--occupancy 0.5: belongs to --schedule"),
    (
        {"nodes": "20,60", "number": "float64", "schedule": "full", "cluster": "bosch"},
        "cell nodes=60|cell nodes=20",
    ),
    (
        {"changes": "none,3 kill 1;"},
        "cell changes=3 kill 1; .2 of 2.: .*must begin with the number",
    ),
    ({"rounds": "0..2"}, "cell rounds=0 .1 of 3.: --rounds 0: must be at least 1"),
]


@pytest.mark.parametrize(("asked", "says"), BAD_CELLS)
def test_a_cell_that_cannot_run_is_named_before_anything_starts(asked: dict[str, str], says: str):
    with pytest.raises(ValueError, match=says):
        checked_cells(specify(asked))


def test_how_many_more_cells_cannot_run_is_said():
    with pytest.raises(ValueError, match="1 more of its cells"):
        checked_cells(specify({"graph": "rnig,ring,pth"}))


def test_a_difference_is_told_in_the_words_of_the_options():
    before = specify({"nodes": "9", "graph": "ring,path"}, runs=5)
    now = specify({"nodes": "10", "graph": "ring"}, runs=6)
    assert difference(before, before) == ""
    said = difference(before, now)
    assert "nodes was 9 and is 10" in said
    assert "graph was ring,path and is ring" in said
    assert "runs was 5 and is 6" in said
