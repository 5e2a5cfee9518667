"""The cells of a sweep, all checked before the first one runs."""

from collections.abc import Sequence
from math import ceil

import msgspec

from concord.scenarios.preparation import prepare
from concord.studies.memory import (
    check_memory,
    check_workers,
    needed_bytes,
    require_memory,
)
from concord.studies.sweep.pieces import runs_at_once
from concord.studies.sweep.specification import Cell, Specification, cells_of, shown

# Four histories of a run stay in memory until the end, and once more as the result is written.
_KEPT_BYTES = 2 * 4 * 8
# Estimates (nodes x runs x steps) of a sweep up to which it keeps histories by itself.
MOST_WITH_HISTORIES = 100_000_000


def with_keep(specification: Specification, keep: str | None) -> Specification:
    """Return the specification that keeps this; histories where None, moments of large sweeps.

    Raises:
        ValueError: a cell of an unknown name or option.
    """
    if keep is None:
        keep = "histories" if estimates_of(specification) <= MOST_WITH_HISTORIES else "moments"
    return msgspec.structs.replace(specification, keep=keep)


def estimates_of(specification: Specification) -> int:
    """Return the estimates of a sweep: nodes x runs x steps, over its cells."""
    sizes = (cell.scenario.nodes * cell.scenario.steps for cell in cells_of(specification))
    return sum(sizes) * specification.runs


def checked_cells(specification: Specification, workers: int = 1) -> list[Cell]:
    """All cells of a sweep, each of which can run, and so many pieces of them at once.

    Raises:
        ValueError: naming the first cell that cannot, why, and how many more there are.
    """
    good, bad = sorted_out(cells := cells_of(specification), exact=specification.exact)
    if bad:
        cell, reason = bad[0]
        more = f"; {len(bad) - 1} more of its cells cannot run" if len(bad) > 1 else ""
        raise ValueError(f"cell {cell.name} ({cell.number + 1} of {len(good) + len(bad)}): "
                         f"{reason}{more}")  # fmt: skip
    of_run = {
        "histories": lambda one: one.steps,
        "figures": lambda one: one.nodes,
        "moments": lambda _: 0,
    }[specification.keep]
    require_memory(
        sum(of_run(one.scenario) for one in cells) * specification.runs * _KEPT_BYTES,
        f"{len(cells)} cells of {specification.runs} runs",
        "use --keep moments, or fewer --steps or --runs",
    )
    needs = [
        (needed_bytes(cell.scenario, together), ceil(specification.runs / together))
        for cell in good
        for together in [min(specification.runs, runs_at_once(cell.scenario, specification.keep))]
    ]
    # More pieces of a cell than workers are never computed at once.
    check_workers((need for need, pieces in needs for _ in range(min(pieces, workers))), workers)
    return good


def sorted_out(
    cells: Sequence[Cell], runs: int = 1, exact: bool = False
) -> tuple[list[Cell], list[tuple[Cell, ValueError]]]:
    """Return the cells that can compute so many runs at once, with exact figures where asked, and
    the others with the reason."""
    good: list[Cell] = []
    bad: list[tuple[Cell, ValueError]] = []
    for cell in cells:
        try:
            check_memory(cell.scenario, runs)
            setup = prepare(cell.scenario)
            if exact:
                # Only here: a study of runs needs nothing of it.
                from concord.studies.exact.network import exact_network

                exact_network(setup)
        except ValueError as error:
            bad.append((cell, error))
        else:
            good.append(cell)
    return good, bad


def difference(before: Specification, now: Specification) -> str:
    """In which words two specifications differ; empty if they do not."""
    old, new = (msgspec.to_builtins(one) for one in (before, now))
    said = []
    for part in ("base", "levels", "ranges"):
        for field in {**old.pop(part), **new.pop(part)}:
            was, wants = (_words(one, field) for one in (before, now))
            if was != wants and (field, was, wants) not in said:
                said.append((field, was, wants))
    said += [(name, str(old[name]), str(new[name])) for name in old if old[name] != new[name]]
    return "; ".join(f"{field} was {was} and is {wants}" for field, was, wants in said)


def _words(specification: Specification, field: str) -> str:
    if field in specification.ranges:
        between = specification.ranges[field]
        return f"{between.low:g}..{between.high:g}"
    values = specification.levels.get(field, [specification.base.get(field, "the default")])
    return ",".join(map(shown, values))
