"""The search of a design on landscapes whose optimum is known; and once for real."""

import io
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rich.console import Console

from concord.bus.schedule import publishers_per_cycle
from concord.experiments.__main__ import main
from concord.experiments.cli.design import lines, table
from concord.runtime.json_file import write_json
from concord.scenarios.bus_table.bus_plan import build_schedule
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.assignment import flat
from concord.scenarios.types.schedules import occupancy_of
from concord.studies.design.candidates import Cost, candidates_of
from concord.studies.design.results import design_of, nearest, read_design
from concord.studies.design.search import FRESH_RUN, Found, SearchTask, search
from concord.studies.design.space import (
    OPEN,
    coarse_grid,
    neighbours_of,
    placements_of,
    space_of,
)
from concord.studies.design.target import BusLimits, parse_target
from concord.studies.sweep.pieces import Piece
from concord.studies.sweep.specification import shown, specify
from tests.experiments.command_support import concord

pytestmark = pytest.mark.slow

ASKED = {"scenario": "oscillator", "nodes": "10", "weights": "metropolis"}


def landscape(noise: float = 0.05, luck: float = 0.0):
    """An engine whose errors are a formula: better with occupancy, rounds, links and hcmci.

    `luck` makes every run of the search better than the fresh ones.
    """

    def figures(piece: Piece) -> dict[str, np.ndarray]:
        s = msgspec.json.decode(piece.scenario, type=Scenario)
        runs = np.arange(piece.first, piece.last)
        schedule, graph, rule = s.bus.schedule, s.network.graph, s.rule.name
        occupancy = occupancy_of(schedule)
        ratio = 1 + 0.1 / occupancy / s.rounds
        ratio += {"ring": 0.3, "complete": 0.0}.get(graph, 0.2)
        ratio += {"ci": 0.3, "hcmci": 0.0, "labelled": 0.4}[rule] + {"dynamic": 0.0}.get(
            schedule.name, 0.02
        )
        if piece.first < FRESH_RUN:
            ratio *= 1 - luck
        common = np.array([1 + noise * np.random.default_rng(r).standard_normal() for r in runs])
        own = np.array(
            [
                1 + noise * np.random.default_rng([int(r), len(graph)]).standard_normal()
                for r in runs
            ]
        )
        sent = occupancy * s.rounds * (2 if rule == "hcmci" else 1) * 100
        return {
            "rmse": ratio * common * own,
            "rmse_centralised": common,
            "published": np.full(len(runs), occupancy),
            "bytes_per_step": np.full(len(runs), sent),
            "energy_per_step": np.full(len(runs), sent * (3 if graph == "complete" else 1)),
            "bus_load": np.full(len(runs), occupancy / 2),
            "delay_us": np.full(len(runs), 1000.0 * s.rounds),
        }

    return engine_of(figures)


def engine_of(figures: Callable[[Piece], dict[str, np.ndarray]]):
    """An engine that gives pieces these figures, the last piece first; others are 1."""
    others = ("rmse_centralised", "anees", "published", "bytes_per_step", "energy_per_step",
              "bus_load", "bus_time_us", "delay_us")  # fmt: skip

    def engine(_function, pieces: Sequence[Piece]):
        for place, piece in reversed(list(enumerate(pieces))):
            found = dict.fromkeys(others, np.ones(piece.runs)) | figures(piece)
            scenario = msgspec.json.decode(piece.scenario, type=Scenario)
            yield place, {"bound": np.ones(scenario.steps), **found}

    return engine


def found_for(
    target: str, cost: Cost = "occupancy", **landscape_is: float
) -> tuple[SearchTask, Found]:
    settled, space = space_of(specify(ASKED))
    task = SearchTask(
        parse_target(target), cost, settled, space, 60, landscape(**landscape_is), 1, lambda _: None
    )
    return task, search(task, [], [])


def test_it_finds_the_least_occupancy_that_meets_the_target():
    _, found = found_for("1.6x-centralised")
    assert found.recommended is not None
    best = found.recommended.candidate.cell.values
    # 1 + 0.1 / occupancy / rounds <= 1.6 on the complete graph with hcmci: one publisher of ten
    # nodes is an occupancy of 0.1, with 2 rounds 1.5; with 1 round 2.
    assert best["occupancy"] == 0.1 and best["rounds"] == 2
    assert found.recommended.error.high <= 1.6


def test_every_run_of_a_search_is_in_its_progress():
    told: list[tuple[int, list[int]]] = []

    @contextmanager
    def progress(_title: str, total: int) -> Iterator[Callable[[int], None]]:
        told.append((total, []))
        yield told[-1][1].append

    settled, space = space_of(specify(ASKED))
    target = parse_target("1.6x-centralised")
    task = SearchTask(
        target, "occupancy", settled, space, 60, landscape(), 1, lambda _: None, progress
    )
    found = search(task, [], [])
    for total, done in told:
        assert done == sorted(done) and done[-1:] == ([total] if total else [])
    tried = [*found.candidates, *(one.candidate for one in found.confirmed)]
    assert sum(total for total, _ in told) == sum(one.runs for one in tried)


@pytest.mark.parametrize(("dearer", "preferred"), [(0.01, "urgency"), (5.0, "wtod")])
def test_of_equal_costs_the_one_with_a_bounded_age_comes_first(dearer: float, preferred: str):
    """An ideal arbiter may never serve a node; urgency classes serve each of them."""
    asked = {
        **ASKED, "graph": "complete", "rule": "ci", "rounds": "1", "occupancy": ".5",
        "schedule": "dynamic", "arbiter": "wtod,urgency", "number": "float64",
    }  # fmt: skip

    def figures(piece: Piece) -> dict[str, np.ndarray]:
        arbiter = flat(msgspec.json.decode(piece.scenario, type=Scenario))["arbiter"]
        swing = (-1.0) ** np.arange(piece.first, piece.last)
        sent = 100 + (dearer + swing if arbiter == "urgency" else -swing)
        return {"bytes_per_step": sent, "rmse": np.ones(piece.runs)}

    settled, space = space_of(specify(asked))
    target = parse_target("2x-centralised")
    task = SearchTask(target, "bytes", settled, space, 31, engine_of(figures), 1, lambda _: None)
    found = search(task, [], [])
    by_cost = {str(one.cell.values["arbiter"]): one for one in found.candidates}
    apart = by_cost["urgency"].cost("bytes")[0] - by_cost["wtod"].cost("bytes")[0]
    assert apart > 0, "the one without a bound is the cheaper one"
    design = design_of(task, found, True)
    assert design.recommended is not None
    assert design.recommended.values == {"arbiter": preferred}
    was = {"arbiter": "wtod"} if preferred == "urgency" else None
    assert design.recommended.instead_of == was
    bounds = {str(one.values["arbiter"]): one.age_bound_steps for one in design.tried if one.front}
    assert bounds["wtod"] is None
    said = "\n".join(lines(design))
    assert ("preferred to arbiter wtod, which costs the same" in said) == (was is not None)
    console = Console(markup=False, width=200, record=True, file=io.StringIO())
    console.print(table(design))
    assert "none" in console.export_text()


def test_other_costs_have_other_winners():
    _, by_bytes = found_for("1.6x-centralised", "bytes")
    _, by_energy = found_for("1.6x-centralised", "energy")
    assert by_bytes.recommended is not None and by_energy.recommended is not None
    bytes_of = [one.recommended.candidate.cost("bytes")[0] for one in (by_bytes, by_energy)]  # type: ignore[union-attr]
    energy_of = [one.recommended.candidate.cost("energy")[0] for one in (by_bytes, by_energy)]  # type: ignore[union-attr]
    assert bytes_of[0] <= bytes_of[1] and energy_of[1] <= energy_of[0]


def test_luck_is_found_out_on_fresh_runs():
    _, found = found_for("1.3x-centralised", luck=0.2)
    tried = found.confirmed
    assert tried and not tried[0].meets
    # All attempts together err in at most 5 %.
    assert sum(1 - one.confidence for one in tried) <= 0.05
    for one in tried:
        assert one.meets == (one.error.high <= 1.3)


def test_a_target_that_nothing_meets_says_the_best():
    task, found = found_for("1.001x-centralised")
    assert found.recommended is None and not found.confirmed
    design = design_of(task, found, True)
    best = nearest(design)
    assert best.values["graph"] == "complete" and best.values["rule"] == "hcmci"
    assert best.error.value < 1.1


def test_the_front_is_written_and_read_again(tmp_path: Path):
    task, found = found_for("1.6x-centralised")
    design = design_of(task, found, True)
    write_json(tmp_path / "d.json", design)
    assert read_design(tmp_path / "d.json") == design
    line = sorted((one for one in design.tried if one.front), key=lambda one: one.error.value)
    costs = [(one.costs["occupancy"], one.costs["bytes"]) for one in line]
    assert costs == sorted(costs, reverse=True)
    assert design.recommended is not None
    assert design.recommended.command.startswith("concord run --scenario oscillator --nodes 10")


def test_every_value_can_be_reached_from_the_coarse_grid():
    settled, space = space_of(specify({"scenario": "oscillator"}))
    assert set(space) == set(OPEN)
    reached = coarse_grid(settled, space)
    known = {tuple(sorted(one.items())) for one in reached}
    for one in reached:
        for new in neighbours_of(settled, one, space):
            if (key := tuple(sorted(new.items()))) not in known:
                known.add(key)
                reached.append(new)
    for field, values in space.items():
        assert {one[field] for one in reached if field in one} >= set(values), field
    assert all((one["occupancy"] == 1.0) == (one["schedule"] == "full") for one in reached)


OF_THE_README = {"scenario": "oscillator", "nodes": "5", "steps": "60", "graph": "ring,complete",
                 "weights": "metropolis", "rounds": "1,2", "schedule": "hybrid"}  # fmt: skip


@pytest.mark.parametrize(
    ("asked", "publishers"),
    [
        (OF_THE_README, {1, 2, 3, 4, 5}),
        ({**OF_THE_README, "occupancy": ".05,.1,.2,.25,.7,.95,1"}, {1, 4, 5}),
        ({**OF_THE_README, "nodes": "30"}, {1, 2, 3, 5, 7, 10, 14, 21, 30}),
        ({**OF_THE_README, "nodes": "3,5"}, {1, 2, 3, 4, 5}),
        ({**ASKED, "occupancy": "1"}, {10}),
    ],
)
def test_no_candidate_is_raced_twice(asked: dict[str, str], publishers: set[int]):
    settled, space = space_of(specify(asked))
    reached = coarse_grid(settled, space)
    for one in reached:
        reached += [new for new in neighbours_of(settled, one, space) if new not in reached]
    good, refused = candidates_of(settled, reached, 0, 1)
    assert good and not refused
    raced, sending = [], set()
    for scenario in (one.cell.scenario for one in good):
        schedule = build_schedule(scenario)
        sent = len(schedule.static_senders(0)) + schedule.dynamic_slots(0)
        sending.add(sent)
        network = scenario.nodes, scenario.network, scenario.rounds, scenario.rule
        raced.append((*network, sent, sent < scenario.nodes and scenario.bus.schedule.name))
    assert len({msgspec.json.encode(one) for one in raced}) == len(raced)
    assert sending == publishers


def test_the_printed_occupancy_is_that_of_the_candidate():
    _, space = space_of(specify({"scenario": "oscillator", "nodes": "7"}))
    for count, occupancy in enumerate(space["occupancy"], start=1):
        assert isinstance(occupancy, float) and float(shown(occupancy)) == occupancy
        assert publishers_per_cycle(7, occupancy) == count
    assert len(space["occupancy"]) == 7


@pytest.mark.study
def test_a_design_is_what_a_fresh_sweep_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    fields = ["--scenario", "oscillator", "--nodes", "4", "--steps", "30", "--graph", "ring,path",
              "--rule", "ci", "--rounds", "1,2", "--occupancy", ".5,1"]  # fmt: skip
    out = tmp_path / "d.json"
    main(["design", *fields, "--target-rmse", "1.5x-centralised", "--runs", "30", "-o", str(out),
          "--json"])  # fmt: skip
    printed = json.loads(capsys.readouterr().out)
    best = printed["recommended"]["values"]
    again = [part for field, value in best.items() for part in (f"--{field}", str(value))]
    main(["sweep", *fields[:6], *again, "--seed", "2", "--runs", "30", "--json",
          "-o", str(tmp_path / "s.nc")])  # fmt: skip
    value, low, high = json.loads(capsys.readouterr().out)["cells"][0]["to_centralised"]
    assert value < 1.5 and low < printed["recommended"]["error"][0] < 1.2 * high


def test_candidates_that_cannot_run_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ("--target-rmse", "2x-bound", "--graph", "rnig,rnig2", "-o", tmp_path / "d.json")
    said = concord(capsys, "design", *words)
    assert said.code == 2 and "none of the candidates can run" in said.err.splitlines()[-1]
    assert not list(tmp_path.iterdir())


def test_a_design_bears_all_placements_and_says_the_error_of_each():
    """Run r has placement r modulo their number, however many runs a candidate grows by."""
    taken: dict[bytes, list[int]] = {}

    def figures(piece: Piece) -> dict[str, np.ndarray]:
        scenario = msgspec.json.decode(piece.scenario, type=Scenario)
        runs = np.arange(piece.first, piece.last)
        taken.setdefault(piece.scenario, []).extend(runs.tolist())
        return {
            "rmse": 1.0 + flat(scenario)["placement"] + 0.001 * (runs % 100),
            "bytes_per_step": np.full(len(runs), 10.0 + (scenario.rule.name == "hcmci")),
        }

    asked = {
        "scenario": "target-tracking", "placement": "0,1,2", "rule": "ci,hcmci", "graph": "ring",
        "rounds": "1", "occupancy": "1", "weights": "metropolis", "steps": "40",
    }  # fmt: skip
    specification = specify(asked)
    settled, space = space_of(specification)
    assert "placement" not in space
    placements = placements_of(specification)
    task = SearchTask(
        parse_target("9x-centralised"), "bytes", settled, space, 31, engine_of(figures), 1,
        lambda _: None, placements=placements,
    )  # fmt: skip
    found = search(task, [], [])
    for one in found.candidates:
        run = np.arange(one.runs)
        np.testing.assert_allclose(one.figures["rmse"], 1 + run % 3 + 0.001 * (run // 3 % 100))
    for runs in taken.values():
        assert len(runs) == len(set(runs)), "no run is computed twice"
    attempt = design_of(task, found, True).recommended
    assert attempt is not None
    assert [one.placement for one in attempt.by_placement] == ["0", "1", "2"]
    errors = [one.error.value for one in attempt.by_placement]
    np.testing.assert_allclose(np.diff(errors), 1, rtol=0.01)


def test_limits_refuse_candidates_with_the_limit_and_what_they_have():
    settled, space = space_of(specify(ASKED))
    task = SearchTask(
        parse_target("3x-centralised"), "bytes", settled, space, 31, landscape(), 1, lambda _: None,
        limits=BusLimits(latency_ms=2.0, load=0.3),
    )  # fmt: skip
    found = search(task, [], [])
    # The landscape has a delay of 1 ms a round, and a load of half the occupancy.
    for one in found.candidates:
        assert (
            one.cell.values["rounds"] in (1, 2) and float(str(one.cell.values["occupancy"])) <= 0.6
        )
    reasons = {one.reason for one in found.refused}
    assert "--latency-ms 2: it has 3" in reasons and "--load 0.3: it has 0.5" in reasons
    assert found.recommended is not None


def test_options_that_a_rule_has_not_make_no_second_candidate():
    settled, space = space_of(specify({"scenario": "target-tracking", "graph": "ring"}))
    reached = coarse_grid(settled, space)
    for one in reached:
        near = neighbours_of(settled, one, space)
        reached += [new for new in near if new not in reached][:40]
        if len(reached) > 200:
            break
    for one in reached:
        if one["rule"] == "labelled":
            assert "weights" not in one and "number" not in one and "record_number" in one
        else:
            assert "weights" in one and "number" in one and "relay" not in one
