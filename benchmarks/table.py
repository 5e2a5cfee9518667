"""Results of `make bench` as one table.

Reason for a file of its own: the comparison of two runs imports it without the benchmarks.
"""

from benchmarks.measure import BenchmarkFigure, BenchmarkFigures


def table(results: dict[str, BenchmarkFigures]) -> str:
    """One line per figure, in the order of measuring: median, quartiles, unit."""
    lines = [f"{'':<50}{'median':>10}{'quartiles':>22}"]
    for bench, figures in results.items():
        lines += ["", bench]
        lines += [f"  {name:<48}{_in_numbers(figure)}" for name, figure in figures.items()]
    return "\n".join(lines)


def _in_numbers(figure: BenchmarkFigure) -> str:
    quartiles = f"{figure.low:.4g} - {figure.high:.4g}"
    return f"{figure.value:>10.4g}{quartiles:>22}  {figure.unit}".rstrip()
