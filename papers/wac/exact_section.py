"""Section 3.1 of the consensus study as tables: ours above the specification's digits."""

import numpy as np

from concord.papers.kit.report import Section, markdown_table
from concord.papers.wac.exact import (
    FUSED,
    GEOMETRIC_SEED,
    GRAPHS,
    PRINTED_ALONE,
    PRINTED_GRAPHS,
    PRINTED_LARGEST,
    PRINTED_RING,
    PRINTED_ROUNDS,
    ROUNDS,
    SETTLED_STEPS,
    STEPS,
    Exact,
    checks_of,
    graph_row,
    largest,
    printed,
    ring_table,
)

NAMES = {"wac": "WAC", "ci": "CI", "hcmci": "HCMCI-safe", "icf": "ICF (g = N)"}


def section(place: int, exact: Exact) -> Section:
    """The tables, how far they are from the print, and the promises of the rules."""
    return Section(
        place,
        "The rules without chance (section 3.1 of the study)",
        "\n\n".join((_introduction(exact), _ring(exact), _graphs(exact), _remarks(exact))),
        checks_of(exact),
        data=_data(exact),
    )


def unequal_cells(exact: Exact) -> list[str]:
    """Cells of the ring table that do not round to what is printed, by name."""
    found = []
    for plant, lines in PRINTED_RING.items():
        if plant not in exact.after:
            continue
        away = np.abs(ring_table(exact, plant) - np.stack([printed(line) for line in lines]))
        for at, rule, figure in np.argwhere(away > 0.005):
            name = ("relative RMSE", "ANEES", "lambda_max")[figure]
            found.append(f"{plant}, {PRINTED_ROUNDS[at]} rounds, {FUSED[rule]}, {name}")
    return found


def _introduction(exact: Exact) -> str:
    modulus = exact.slem["geometric"]
    return (
        "The joint error covariance of all eight nodes, carried through "
        f"{STEPS} steps; no Monte Carlo. Cells: relative RMSE (root mean square over the nodes, "
        "in the metric of the centralised covariance) / ANEES (mean over the nodes) / lambda_max "
        "(largest over the nodes; at most 1 is consistent). Below, in italics, the study's digits. "
        "The study does not say its horizon. All plants but the bus settle within 300 steps; the "
        f"bus has the printed digits near {STEPS} steps and still moves: see below. The study "
        "gives the second eigenvalue modulus of its geometric graph, .743, and not the graph; "
        f"ours is `geometric` with seed {GEOMETRIC_SEED}, modulus {modulus:.3f}, so its figures "
        "differ."
    )


def _ring(exact: Exact) -> str:
    rows = []
    for plant in exact.after:
        ours = ring_table(exact, plant)
        for place, rounds in enumerate(PRINTED_ROUNDS):
            beside = PRINTED_RING[plant][place].split()
            cells = [
                f"{_join(values)}<br>*{text}*"
                for values, text in zip(ours[place], beside, strict=True)
            ]
            rows.append((plant if place == 0 else "", str(rounds), *cells))
    head = ("plant", "L", *(NAMES[rule] for rule in FUSED))
    unequal = unequal_cells(exact)
    total = sum(ring_table(exact, plant).size for plant in exact.after)
    verdict = f"{total - len(unequal)} of {total} cells round to the printed digits."
    if unequal:
        verdict += f" Not: {'; '.join(unequal)}."
    return f"### Ring\n\n{markdown_table(head, rows)}\n\n{verdict}"


def _graphs(exact: Exact) -> str:
    rows = []
    for graph in GRAPHS:
        beside = PRINTED_GRAPHS[graph].split()
        ours = graph_row(exact, graph)
        cells = [f"{_join(values)}<br>*{text}*" for values, text in zip(ours, beside, strict=True)]
        rows.append((f"{graph} ({exact.slem[graph]:.3f})", *cells))
    head = ("graph (modulus)", *(NAMES[rule] for rule in FUSED))
    title = "### Position, one round: relative RMSE / lambda_max / disagreement"
    return f"{title}\n\n{markdown_table(head, rows)}"


def _remarks(exact: Exact) -> str:
    most = ", ".join(
        f"{NAMES[rule]} {largest(exact, rule):.3f} (printed {PRINTED_LARGEST[rule]:g})"
        for rule in FUSED
    )
    settled = "; ".join(
        f"{NAMES[rule]} "
        + ", ".join(_join(exact.settled_bus[rule][ROUNDS.index(c), :3]) for c in PRINTED_ROUNDS)
        for rule in FUSED
    )
    alone = ", ".join(
        f"{plant} {figures[0]:.3g} ({PRINTED_ALONE[plant]:g})"
        for plant, figures in exact.alone.items()
    )
    return (
        f"Largest lambda_max over all plants, graphs and L: {most}.\n\n"
        f"The bus on the ring after {SETTLED_STEPS} steps, settled, at L = 1, 5, 20: {settled}.\n\n"
        "Alone (L = 0) every node is consistent exactly, and those that see too little drift: "
        f"relative RMSE after {STEPS} steps, and printed, for a horizon and priors that the study "
        f"does not name: {alone}."
    )


def _join(values: np.ndarray) -> str:
    return "/".join(f"{value:.2f}" for value in values)


def _data(exact: Exact) -> dict:
    return {
        "steps": STEPS,
        "graphs": list(GRAPHS),
        "rounds": list(ROUNDS),
        "figures": ["relative_rmse", "anees", "lambda_max", "disagreement"],
        "after": {
            plant: {rule: values.tolist() for rule, values in rules.items()}
            for plant, rules in exact.after.items()
        },
        "settled_bus": {rule: values.tolist() for rule, values in exact.settled_bus.items()},
        "largest_lambda_max": {rule: largest(exact, rule) for rule in FUSED},
        "alone": {plant: figures.tolist() for plant, figures in exact.alone.items()},
        "second_eigenvalue_modulus": exact.slem,
        "unequal_cells": unequal_cells(exact),
    }
