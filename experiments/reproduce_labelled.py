"""`concord reproduce labelled`: labelled measurements beside consensus on beliefs, on TRACK.

What it is held against are the project's own study of fusion under bus limits, and its acceptance
bounds.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from experiments.labelled_cases import CUT, HUB, HUB_DEAD, Case, CaseOutcome, run_case
from experiments.labelled_study import FORMS, OCCUPANCIES, SEED, Cell, cells, workers
from experiments.reproduce_report import Check, Reproduction, Section, at_most, markdown_table

RUNS = 50
PICTURE = "labelled.png"
EXCESS_MOST = 0.03
_COLOURS = {
    "labelled, hybrid": "#0072B2",
    "labelled, hybrid-leaves": "#56B4E9",
    "labelled, dynamic": "#009E73",
    "labelled relay, hybrid": "#CC79A7",
    "labelled relay, dynamic": "#000000",
    "ci": "#E69F00",
    "hcmci": "#D55E00",
    "wac": "#999999",
}
_SCORED_FROM = 20

Table = dict[tuple[str, float], Cell]


def reproduction(runs: int | None) -> Reproduction:
    """The study with so many runs of each cell, 50 unless given; cases with a fifth of that."""
    count = RUNS if runs is None else runs
    return Reproduction(
        "Labelled measurements on TRACK", SEED, lambda folder: _sections(folder, count)
    )


def _sections(folder: Path, runs: int) -> Iterator[Section]:
    table: Table = {(form.name, part): cell for form, part, cell in cells(FORMS, runs)}
    draw(table, folder / PICTURE)
    yield error_section(table, runs)
    few = max(2, runs // 5)
    yield cases_section(case_outcomes(few), few)


def error_section(table: Table, runs: int) -> Section:
    """The table of errors, bytes and consistency, and what must hold of it."""
    head = (
        "form", "occupancy", "x centralised", "ANEES", "worst node - central", "bytes said",
        "bytes on the wire", "us on the wire", "coverage %", "checkpoints %",
    )  # fmt: skip
    rows = [
        (
            name, f"{part:g}", f"{c.ratio:.3f} ± {c.half_width:.3f}", f"{c.anees:.3f}",
            f"{c.excess:+.3f} ± {c.excess_half_width:.3f}", f"{c.said_bytes:.0f}",
            f"{c.wire_bytes:.0f}", f"{c.wire_us:.0f}", _percent(c.coverage),
            _percent(c.checkpoint_share),
        )
        for (name, part), c in table.items()
    ]  # fmt: skip
    text = (
        f"{runs} runs of `target-tracking`, 20 nodes, 3 rounds; RMSE over that of the centralised "
        "filter on the same noise, with 95 % jackknife intervals; bytes and microseconds per step "
        "of all nodes. Said: before numbers, headers and the padding of static frames.\n\n"
        f"![error against bytes]({PICTURE})\n\n{markdown_table(head, rows)}"
    )
    return Section(1, "Error and bytes", text, checks=list(_checks(table)))


def _checks(table: Table) -> Iterator[Check]:
    for (name, part), c in table.items():
        if not name.startswith("labelled"):
            continue
        # The worst of twenty nodes is picked after the fact: its interval counts.
        yield at_most(
            f"{name}, {part:g}: lower end of the worst node's ANEES minus the centralised one",
            c.excess - c.excess_half_width,
            EXCESS_MOST,
        )
        rival = table.get(("ci", part))
        if rival is not None:
            yield at_most(f"{name}, {part:g}: error over that of ci", c.ratio / rival.ratio, 1.0)


def draw(table: Table, file: Path) -> None:
    """Error against bytes, a line per form, a point per occupancy."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for name in dict.fromkeys(name for name, _ in table):
        points = [table[name, part] for part in OCCUPANCIES if (name, part) in table]
        axes.errorbar(
            [c.said_bytes for c in points],
            [c.ratio for c in points],
            [c.half_width for c in points],
            marker="o" if name.startswith("labelled") else "s",
            markersize=4,
            linewidth=1.2,
            capsize=2,
            color=_COLOURS[name],
            label=name,
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="bytes that all nodes say per step",
        ylabel="RMSE over that of the centralised filter",
        title="TRACK: occupancy 1, 0.5, 0.25, 0.1 from right to left",
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(ScalarFormatter())
    axes.set_yticks([1, 1.5, 2, 3, 5, 10])
    axes.set_xticks([300, 500, 1000, 2000, 5000, 10000])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(file, dpi=110)


# --- what goes wrong -----------------------------------------------------------------------------


def _case(occupancy: float, **options: Any) -> dict[str, Any]:
    return {"occupancy": occupancy, "schedule": "hybrid", **options}


PARTS = (1.0, 0.25, 0.1)
CASES: dict[str, Case] = {
    **{
        f"loss {loss:.0%}, digest {digest}, {'relay, ' * relay}{part:g}": Case(
            _case(part, digest_steps=digest, relay=relay), loss=loss
        )
        for loss in (0.1, 0.3)
        for digest in (0, 8)
        for relay in (False, True)
        for part in PARTS
    },
    **{
        f"path of 20, {'relay, ' * relay}{part:g}": Case(_case(part, graph="path", relay=relay))
        for relay in (False, True)
        for part in PARTS
    },
    **{f"hub dead, {part:g}": Case(_case(part), hub_dies=True) for part in PARTS},
    **{
        f"cut, digest {digest}, {part:g}": Case(_case(part, digest_steps=digest), cut=True)
        for digest in (0, 8)
        for part in PARTS
    },
}


def case_outcomes(runs: int) -> Iterator[tuple[str, list[CaseOutcome]]]:
    """Every case by name, with its runs."""
    with workers() as pool:
        jobs = [(case, run) for case in CASES.values() for run in range(runs)]
        found = pool.map(run_case, *zip(*jobs, strict=True))
        for name in CASES:
            yield name, [next(found) for _ in range(runs)]


def cases_section(outcomes: Iterator[tuple[str, list[CaseOutcome]]], runs: int) -> Section:
    """Errors and consistency where something goes wrong."""
    rows, hub_rows, cut_rows = [], [], []
    for name, found in outcomes:
        if CASES[name].hub_dies:
            hub_rows.append((name, *_at(found, [HUB], range(HUB_DEAD.stop, HUB_DEAD.stop + 4))))
        elif CASES[name].cut:
            last = CUT.stop
            cut_rows.append((name, *_at(found, None, [last - 1, *range(last, last + 5)])))
        else:
            rows.append((name, *_overall(found)))
    text = "\n\n".join(
        (
            f"{runs} runs of each case, hybrid schedule; errors over those of the centralised "
            "filter, which loses nothing.",
            markdown_table(("case", "x centralised", "ANEES", "worst node's ANEES"), rows),
            f"Node {HUB}, a hub, is dead from step {HUB_DEAD.start} and comes back cold at step "
            f"{HUB_DEAD.stop}. Its own error at steps {HUB_DEAD.stop}, +1, +2, +3 (- where it "
            "still says that it knows nothing):",
            markdown_table(("case", "at once", "+1", "+2", "+3"), hub_rows),
            f"The network is cut in two from step {CUT.start} to {CUT.stop - 1}. Error of all "
            "nodes in the last step of the cut, and in the first after it:",
            markdown_table(("case", "cut", "at once", "+1", "+2", "+3", "+4"), cut_rows),
        )
    )
    return Section(2, "Loss, a dead hub, a cut, a path", text)


def _overall(found: Sequence[CaseOutcome]) -> tuple[str, str, str]:
    first = _SCORED_FROM
    squared = np.stack([one.squared[first:] for one in found])
    central = np.stack([one.squared_centralised[first:] for one in found])
    per_node = np.nanmean(np.stack([one.consistency[first:] for one in found]), axis=(0, 1))
    ratio = np.sqrt(np.nanmean(squared) / central.mean())
    return f"{ratio:.3f}", f"{per_node.mean():.3f}", f"{per_node.max():.3f}"


def _at(
    found: Sequence[CaseOutcome], nodes: Sequence[int] | None, steps: Sequence[int]
) -> tuple[str, ...]:
    squared = np.stack([one.squared for one in found])
    central = np.stack([one.squared_centralised for one in found])
    # One step of a few runs says little of the centralised filter: its error is that of all steps.
    scale = central[:, _SCORED_FROM:].mean()
    said = []
    for step in steps:
        errors = squared[:, step] if nodes is None else squared[:, step][:, list(nodes)]
        unknown = np.isnan(errors).all()
        said.append("-" if unknown else f"{np.sqrt(np.nanmean(errors) / scale):.2f}")
    return tuple(said)


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.2f}"
