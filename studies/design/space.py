"""Search space of a design: the values of each field, a coarse grid, and neighbouring
candidates.

Occupancies are numbers of publishers: S / N of N nodes. So no two candidates differ only in
occupancies that let equally many nodes publish.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from concord.bus.schedule import publishers_per_cycle
from concord.scenarios.catalogue import definition_of
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.scenario_options import scenario_with_known
from concord.studies.sweep.specification import Specification, Value

Values = dict[str, Value]
# Sensors stand somewhere whatever is designed: several placements are borne and not chosen from.
PLACEMENT = "placement"

# Fields that are open unless the user says otherwise. Rules that are overconfident or may diverge
# are not offered unasked.
OPEN: dict[str, tuple[Value, ...]] = {
    "graph": ("ring", "4-regular", "small-world", "complete"),
    "rule": ("ci", "hcmci", "labelled"),
    "weights": ("metropolis", "best-constant"),
    "rounds": (1, 2, 3, 5),
    "occupancy": (),
    "schedule": ("hybrid", "dynamic", "round-robin"),
    "number": ("float32", "float64"),
    "record_number": ("int16", "float32"),
    "relay": (False, True),
}
# An open occupancy has at most so many values: all S / N of a small network, and of a larger one
# numbers of publishers in equal ratios.
MOST_OCCUPANCIES = 10
# The first look: every combination of these, where they are among the values of the field; and the
# least, the middle and the greatest occupancy.
COARSE: dict[str, tuple[Value, ...]] = {
    "weights": ("metropolis",),
    "rounds": (1, 3),
    "schedule": ("dynamic",),
    "number": ("float32",),
    "record_number": ("int16",),
    "relay": (False,),
}
_ORDERED = ("rounds", "occupancy")


def space_of(specification: Specification) -> tuple[Values, dict[str, list[Value]]]:
    """Return the fixed fields, and the open fields with their values, of a specification.

    Raises:
        ValueError: there is no such scenario, its data cannot be read, or an occupancy is none.
    """
    settled = dict(specification.base)
    asked: dict[str, Any] = {**settled}
    scenario, _ = scenario_with_known(**asked)
    own = definition_of(scenario).defaults.network.graph
    space = {field: list(values) for field, values in OPEN.items() if field not in settled}
    if "graph" in space and own not in space["graph"]:
        space["graph"].insert(0, own)
    space |= specification.levels
    if placements := placements_of(specification):
        del space[PLACEMENT]
        settled[PLACEMENT] = placements[0]
    nodes = max(int(count or 1) for count in space.get("nodes", [scenario.nodes]))
    given = space.get("occupancy", [settled.get("occupancy")])
    shares = _shares(given or _every_share(nodes), nodes)
    if "occupancy" in space:
        space["occupancy"] = shares
    if shares == [1.0] and "schedule" in space and "schedule" not in specification.levels:
        space["schedule"] = ["full"]
    settled |= {field: values[0] for field, values in space.items() if len(values) == 1}
    return settled, {field: values for field, values in space.items() if len(values) > 1}


def placements_of(specification: Specification) -> tuple[Value, ...]:
    """Return the placements of sensors that the network must bear; none where it is one."""
    return tuple(specification.levels.get(PLACEMENT, ()))


def _every_share(nodes: int) -> list[Value]:
    counts = np.geomspace(1, nodes, MOST_OCCUPANCIES).round()
    return [count / nodes for count in (range(1, nodes + 1) if nodes <= len(counts) else counts)]


def _shares(occupancies: Iterable[Value], nodes: int) -> list[Value]:
    """Return S / N for the numbers of publishers that these occupancies mean, each once, ascending.

    Six digits are those of a printed command, which must run the very candidate.
    """
    counts = {publishers_per_cycle(nodes, float(one)) for one in occupancies}  # type: ignore[arg-type]
    return [float(f"{count / nodes:.6g}") for count in sorted(counts)]


def tidy(values: Values) -> Values:
    """Return the same candidate with the one name that it has.

    Its occupancy is S / N of its own nodes; a bus on which all nodes publish needs no schedule.
    """
    if "nodes" in values and "occupancy" in values:
        nodes = int(values["nodes"] or 1)
        values = {**values, "occupancy": _shares([values["occupancy"]], nodes)[0]}
    if values.get("occupancy") == 1.0 and "schedule" in values:
        return {**values, "schedule": "full"}
    return values


def relevant(settled: Values, values: Values) -> Values:
    """Return the fields of a candidate that change something: its rule and its bus have them."""
    asked: dict[str, Any] = {**settled, **tidy(values)}
    scenario, left = scenario_with_known(**asked)
    unused = {*left} if rule_of(scenario).weighted else {*left, "weights"}
    return {name: value for name, value in tidy(values).items() if name not in unused}


def coarse_grid(settled: Values, space: Mapping[str, Sequence[Value]]) -> list[Values]:
    """Return the candidates of the first look."""
    few = {
        field: [v for v in values if v in COARSE.get(field, values)] or list(values)[:2]
        for field, values in space.items()
    }
    if "occupancy" in few:
        shares = few["occupancy"]
        few["occupancy"] = [shares[0], shares[len(shares) // 2], shares[-1]]
    combinations = itertools.product(*few.values())
    return _once(relevant(settled, dict(zip(few, values, strict=True))) for values in combinations)


def neighbours_of(
    settled: Values, values: Values, space: Mapping[str, Sequence[Value]]
) -> list[Values]:
    """Candidates that differ in one field, by one step of a number or by any name; and those that
    trade rounds for occupancy, all the way."""
    # A candidate has no values for options that another rule or bus has.
    values = {**{field: levels[0] for field, levels in space.items()}, **values}
    near = []
    moves: list[Values] = [
        {field: other} for field, levels in space.items() for other in _near(field, values, levels)
    ]
    if all(field in space for field in _ORDERED):
        moves += [
            {"rounds": rounds, "occupancy": occupancy}
            for rounds in space["rounds"]
            for occupancy in _near("occupancy", values, space["occupancy"])
        ]
    for move in moves:
        moved = {**values, **move}
        if moved.get("schedule") == "full" and moved.get("occupancy", 1.0) != 1.0:
            # It leaves the full bus: any way to share it is as near.
            near += [{**moved, "schedule": way} for way in space.get("schedule", ("hybrid",))]
        else:
            near.append(moved)
    return _once(relevant(settled, one) for one in near)


def _near(field: str, values: Values, levels: Sequence[Value]) -> list[Value]:
    value = values[field]
    if field == "occupancy" and "nodes" in values:
        levels = _shares(levels, int(values["nodes"] or 1))
    if field in _ORDERED and value in levels:
        ordered = sorted(levels, key=lambda level: float(level))  # type: ignore[arg-type]
        place = ordered.index(value)
        return [ordered[i] for i in (place - 1, place + 1) if 0 <= i < len(ordered)]
    if field == "schedule" and value == "full":
        return []
    return [level for level in levels if level != value]


def _once(candidates: Iterable[Values]) -> list[Values]:
    kept: list[Values] = []
    for candidate in candidates:
        if candidate not in kept:
            kept.append(candidate)
    return kept
