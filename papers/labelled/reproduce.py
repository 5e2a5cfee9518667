"""`concord reproduce labelled`: labelled measurements beside consensus on beliefs, on TRACK.

The references are the project's own study of fusion under bus limits, and its acceptance bounds.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from concord.papers.kit.checks import Check, at_most
from concord.papers.kit.figures import save
from concord.papers.kit.report import Paper, Section, markdown_table
from concord.papers.kit.traces import write_traces
from concord.papers.labelled.cases_section import case_outcomes, cases_section
from concord.papers.labelled.exact_section import NETWORKS, exact_section
from concord.papers.labelled.study import FORMS, OCCUPANCIES, FormCell, cells, ratio_text

PICTURE = "labelled"
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
# The project's study measured these values over 200 runs, at these occupancies.
_STUDY = {
    "labelled, hybrid": (1.080, 1.114, 1.254, 1.659),
    "labelled, dynamic": (1.080, 1.084, 1.159, 1.370),
    "labelled relay, hybrid": (1.004, 1.029, 1.149, 1.513),
    "labelled relay, dynamic": (1.004, 1.002, 1.051, 1.261),
}

FormTable = dict[tuple[str, float], FormCell]


def _sections(folder: Path, seed: int, runs: int) -> Iterator[Section]:
    """`runs` of each cell; of the special cases a fifth of that."""
    yield exact_section(NETWORKS)
    table: FormTable = {(form.name, part): cell for form, part, cell in cells(FORMS, seed, runs)}
    save(figure_of(table), folder, PICTURE, dpi=110)
    _write(folder, table)
    yield error_section(table, runs)
    few = max(2, runs // 5)
    yield cases_section(dict(case_outcomes(seed, few)))


PAPER = Paper(
    "Labelled measurements on TRACK",
    seed=1,
    runs=50,
    least_runs=2,
    because="so that an interval can be made",
    sections=_sections,
)


def _write(folder: Path, table: FormTable) -> None:
    forms = list(dict.fromkeys(form for form, _ in table))
    parts = list(dict.fromkeys(part for _, part in table))
    variables = {
        name: (
            ("form", "occupancy"),
            np.array([[getattr(table[form, part], name) for part in parts] for form in forms]),
        )
        for name in FormCell._fields
    }
    write_traces(folder, variables, {"form": forms, "occupancy": np.array(parts)})


def error_section(table: FormTable, runs: int) -> Section:
    """The table of errors, bytes and consistency, and what must hold of it."""
    head = (
        "form", "occupancy", "x centralised", "ANEES", "worst node - central", "bytes said",
        "bytes on the wire", "us on the wire", "coverage %", "checkpoints %",
    )  # fmt: skip
    rows = [
        (
            name, f"{part:g}", ratio_text(c.error), f"{c.anees:.3f}",
            f"{c.excess:+.3f} ± {c.excess_half_width:.3f}", f"{c.said_bytes:.0f}",
            f"{c.wire_bytes:.0f}", f"{c.wire_us:.0f}", _percent(c.coverage),
            _percent(c.checkpoint_share),
        )
        for (name, part), c in table.items()
    ]  # fmt: skip
    text = (
        f"{runs} runs of `target-tracking`, 20 nodes, 3 rounds; RMSE over that of the centralised "
        "filter on the same noise, with 95 % intervals; bytes and microseconds per step "
        "of all nodes. Said: before numbers, headers and the padding of static frames.\n\n"
        f"![error against bytes]({PICTURE}.png)\n\n{markdown_table(head, rows)}"
    )
    return Section(2, "Error and bytes", text, checks=list(_checks(table)))


def _checks(table: FormTable) -> Iterator[Check]:
    for (name, part), c in table.items():
        if not name.startswith("labelled"):
            continue
        yield _consistency_check(f"{name}, {part:g}", c)
        if name in _STUDY:
            yield at_most(
                f"{name}, {part:g}: lower end of the error",
                c.ratio_low,
                _STUDY[name][OCCUPANCIES.index(part)],
            )
        rival = table.get(("ci", part))
        if rival is not None:
            yield at_most(f"{name}, {part:g}: error over that of ci", c.ratio / rival.ratio, 1.0)


def _consistency_check(name: str, c: FormCell) -> Check:
    """The figure itself must be within the bound, whatever the interval says beside it."""
    low, high = c.excess - c.excess_half_width, c.excess + c.excess_half_width
    if high <= EXCESS_MOST:
        verdict = "within"
    elif low > EXCESS_MOST:
        verdict = "beyond"
    else:
        verdict = "undecided by this many runs"
    measured = f"{c.excess:+.4f} ({low:+.4f} to {high:+.4f}: {verdict})"
    return Check(
        f"{name}: ANEES of the worst node minus that of the centralised filter",
        f"at most {EXCESS_MOST:g}",
        measured,
        c.excess <= EXCESS_MOST,
    )


def figure_of(table: FormTable) -> Figure:
    """Error against bytes, a line per form, a point per occupancy."""
    figure = Figure(figsize=(12, 5.5), layout="constrained")
    said, wire = figure.subplots(1, 2, sharey=True)
    _draw_against(said, table, lambda c: c.said_bytes, "bytes that all nodes say per step")
    _draw_against(
        wire, table, lambda c: c.wire_bytes, "bytes on the wire per step, with headers and padding"
    )
    said.set_ylabel("RMSE over that of the centralised filter")
    said.legend(fontsize=8, ncols=2)
    figure.suptitle("TRACK: occupancy 1, 0.5, 0.25, 0.1 from right to left")
    return figure


def _draw_against(
    axes: Axes, table: FormTable, cost: Callable[[FormCell], float], name: str
) -> None:
    for form in dict.fromkeys(form for form, _ in table):
        points = [table[form, part] for part in OCCUPANCIES if (form, part) in table]
        axes.errorbar(
            [cost(c) for c in points],
            [c.ratio for c in points],
            np.array([[c.ratio - c.ratio_low, c.ratio_high - c.ratio] for c in points]).T,
            marker="o" if form.startswith("labelled") else "s",
            markersize=4,
            linewidth=1.2,
            capsize=2,
            color=_COLOURS[form],
            label=form,
        )
    axes.set(xscale="log", yscale="log", xlabel=name)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(ScalarFormatter())
    axes.set_yticks([1, 1.5, 2, 3, 5, 10])
    axes.set_xticks([300, 500, 1000, 2000, 5000, 10000])
    axes.minorticks_off()
    axes.grid(alpha=0.3)


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.2f}"
