"""`concord topology`: graphs shown, analysed, compared and generated."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tyro
from rich.table import Table

from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.studies.progress import progress
from concord.studies.topology.compare import ComparisonRow, compared
from concord.studies.topology.report import NodeLoss, lines, loss_title, losses_of, report_of
from concord.studies.topology.subject import Subject, SubjectOptions, subject_of
from concord.topology.adjacency import nodes_of
from concord.topology.graph_files import write_network

SUMMARY = "Graphs: show, analyse, compare, generate."
_SHOWN_LOSSES = 8
_FILE_WIDTH = 140

Options = Annotated[SubjectOptions, tyro.conf.arg(name="")]
Source = Annotated[str, tyro.conf.Positional]


def analyse(source: Source = "", *, options: Options, json: bool = False) -> None:
    """Connection, convergence predicted and measured, weak points; with --scenario what is seen.

    Args:
        source: A graph's name, a graph file, or a folder of recorded links.
        json: Print one JSON object.
    """
    with user_errors():
        subject = subject_of(source, options, connected=False)
    nodes = nodes_of(subject.weights)
    with progress("nodes taken away", losses_of(nodes), as_json=json) as on_node, user_errors():
        report = report_of(subject, options.seed, on_node)
    if json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
        return
    sys.stdout.write("\n".join(lines(report)) + "\n")
    if report.losses:
        # Above the table and not in it: a title is broken to the width of its columns.
        sys.stdout.write(loss_title(report) + "\n")
        sys.stdout.flush()
        plain_console().print(_loss_table(report.losses))


def compare(
    sources: Annotated[list[str], tyro.conf.Positional],
    /,
    *,
    options: Options,
    seeds: int = 10,
    json: bool = False,
) -> None:
    """A table over several graphs and weights (--weights a,b); random graphs over several seeds,
    with intervals.

    Args:
        sources: Names of graphs, graph files, or a folder of recorded links.
        seeds: How many graphs of a random family are drawn, from --seed on.
        json: Print one JSON object.
    """
    with user_errors():
        if seeds < 1:
            raise ValueError(f"--seeds {seeds}: must be at least 1")
        weights = options.weights.split(",") if options.weights else [None]
        with progress("graphs", len(sources) * len(weights), as_json=json) as on_row:
            rows, notes = compared(sources, options, weights, seeds, on_row)
    sys.stderr.writelines(f"{note}\n" for note in notes)
    if json:
        sys.stdout.write(msgspec.json.encode({"rows": rows}).decode() + "\n")
        return
    plain_console(_FILE_WIDTH).print(_comparison(rows))


def generate(
    source: Source,
    /,
    *,
    options: Options,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    json: bool = False,
) -> None:
    """Write a graph file: the suffix decides, .graphml, .edges or .csv.

    Args:
        source: A graph's name, another graph file, or a folder of recorded links.
        out: The file; it must not exist.
        json: Print one JSON object.
    """
    with user_errors():
        try:
            if out.exists():
                raise ValueError(f"--out {out}: the file exists; choose another name, or remove it")
            if not out.parent.is_dir():
                raise ValueError(f"--out {out}: no such folder {out.parent}; make it first")
            subject = subject_of(source, options)
            _tell(subject)
            write_network(out, subject.network)
        except OSError as error:
            raise ValueError(
                f"--out {out}: cannot be written ({error.strerror}); choose another place"
            ) from None
    nodes, links = nodes_of(subject.weights), subject.network.adjacency.nnz
    result = {
        "file": str(out),
        "graph": source,
        "nodes": nodes,
        "links": links,
        "seed": options.seed,
    }
    text = f"{out}: {source}, {nodes} nodes, {links} links counted each way, seed {options.seed}"
    sys.stdout.write((msgspec.json.encode(result).decode() if json else text) + "\n")


def show(
    source: Source = "",
    *,
    options: Options,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    layout: Literal["auto", "places", "spring", "circle"] = "auto",
    json: bool = False,
) -> None:
    """Draw the graph with its weights, and its spectrum beside it.

    Args:
        source: A graph's name, a graph file, or a folder of recorded links.
        out: The picture: .png, .svg or .pdf.
        layout: Where nodes are drawn: at their places where they have any, else laid out.
        json: Print one JSON object.
    """
    from concord.studies.topology.picture import draw  # only here: it loads matplotlib

    with user_errors():
        subject = subject_of(source, options)
        _tell(subject)
        drawn = draw(subject, out, layout)
    text = f"{out}: {subject.name}, {drawn['nodes']} nodes, {drawn['placed']}"
    sys.stdout.write((msgspec.json.encode(drawn).decode() if json else text) + "\n")


COMMANDS = {"show": show, "analyse": analyse, "compare": compare, "generate": generate}


def _tell(subject: Subject) -> None:
    """Write how the file of a graph was read, where a user must know."""
    for note in subject.network.notes:
        sys.stderr.write(f"{note}\n")


def _loss_table(losses: list[NodeLoss]) -> Table:
    errors = any(loss.error_growth is not None for loss in losses)
    table = Table("loss of node", "leaves")
    table.add_column("factor per round", justify="right")
    if errors:
        table.add_column("error of the worst state", justify="right")
    for loss in losses[:_SHOWN_LOSSES]:
        leaves = "one piece" if loss.pieces == 1 else f"{loss.pieces} pieces"
        cells = [loss.node, leaves, "-" if loss.factor is None else f"{loss.factor:.5g}"]
        if errors:
            cells.append(f"x {loss.error_growth:.3f}")
        table.add_row(*cells)
    return table


def _comparison(rows: list[ComparisonRow]) -> Table:
    table = Table("graph", "weights", "links", show_edge=False)
    for heading in ("drawn", "nodes", "degree", "diameter", "cut nodes"):
        table.add_column(heading, justify="right")
    table.add_column("factor per round", justify="right")
    table.add_column("rounds to 1 %", justify="right")
    for row in rows:
        table.add_row(
            row.graph, row.weights, row.links, str(row.graphs), str(row.nodes),
            row.degree.text(), row.diameter.text(), row.cut_nodes.text(),
            row.factor.text(), row.rounds_to_one_percent.text(),
        )  # fmt: skip
    return table
