"""Search space of a design: the values of each field, a coarse grid, and neighbouring
candidates."""

import itertools
from collections.abc import Iterable, Mapping, Sequence

from experiments.sweep.specification import Specification, Value
from scenarios.catalogue import definition_of

Values = dict[str, Value]

# Fields that are open unless the user says otherwise. Rules that are overconfident or may diverge
# are not offered unasked; neither are those that only a message-by-message run can show.
OPEN: dict[str, tuple[Value, ...]] = {
    "graph": ("ring", "4-regular", "small-world", "complete"),
    "rule": ("ci", "hcmci"),
    "weights": ("metropolis", "best-constant"),
    "rounds": (1, 2, 3, 5),
    "occupancy": (0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0),
    "schedule": ("hybrid", "dynamic", "round-robin"),
}
# The first look: every combination of these, where they are among the values of the field.
COARSE: dict[str, tuple[Value, ...]] = {
    "weights": ("metropolis",),
    "rounds": (1, 3),
    "occupancy": (0.05, 0.2, 1.0),
    "schedule": ("hybrid",),
}
_ORDERED = ("rounds", "occupancy")


def space_of(specification: Specification) -> tuple[Values, dict[str, list[Value]]]:
    """Return the fixed fields, and the open fields with their values, of a specification.

    Raises:
        ValueError: there is no such scenario.
    """
    settled = dict(specification.base)
    name = str(settled.get("scenario", "target-tracking"))
    own = definition_of(name).defaults.network.graph
    space = {field: list(values) for field, values in OPEN.items() if field not in settled}
    if "graph" in space and own not in space["graph"]:
        space["graph"].insert(0, own)
    space |= specification.levels
    return settled, {field: values for field, values in space.items() if len(values) > 1}


def tidy(values: Values) -> Values:
    """Return the same candidate with the one name that it has: who all publish need no schedule."""
    if values.get("occupancy") == 1.0 and "schedule" in values:
        return {**values, "schedule": "full"}
    return values


def coarse_grid(space: Mapping[str, Sequence[Value]]) -> list[Values]:
    """Return the candidates of the first look."""
    few = {
        field: [v for v in values if v in COARSE.get(field, values)] or list(values)[:2]
        for field, values in space.items()
    }
    combinations = itertools.product(*few.values())
    return _once(tidy(dict(zip(few, values, strict=True))) for values in combinations)


def neighbours_of(values: Values, space: Mapping[str, Sequence[Value]]) -> list[Values]:
    """Candidates that differ in one field, by one step of a number or by any name; and those that
    trade rounds for occupancy, all the way."""
    near = []
    moves: list[Values] = [
        {field: other}
        for field, levels in space.items()
        for other in _near(field, values[field], levels)
    ]
    if all(field in space for field in _ORDERED):
        moves += [
            {"rounds": rounds, "occupancy": occupancy}
            for rounds in space["rounds"]
            for occupancy in _near("occupancy", values["occupancy"], space["occupancy"])
        ]
    for move in moves:
        moved = {**values, **move}
        if moved.get("schedule") == "full" and moved.get("occupancy", 1.0) != 1.0:
            # It leaves the full bus: any way to share it is as near.
            near += [{**moved, "schedule": way} for way in space.get("schedule", ("hybrid",))]
        else:
            near.append(tidy(moved))
    return _once(near)


def _near(field: str, value: Value, levels: Sequence[Value]) -> list[Value]:
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
