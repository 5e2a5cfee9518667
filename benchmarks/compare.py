"""`make bench-compare BASE=...`: what has become slower, beyond the spread of both measurements.

python -m benchmarks.compare BASE.json NEW.json
"""

import sys
from pathlib import Path
from typing import NamedTuple

import msgspec

from benchmarks.measure import BenchmarkFigure

# The same code differs more from run to run than from turn to turn: by up to 20 % between 56 pairs
# of runs on one machine. Every figure is taken to waver by at least this part of itself.
LEAST_SPREAD = 0.1


class Kept(msgspec.Struct):
    """A run of the benchmarks as it is kept; what is no table of figures has no place here."""

    machine: dict[str, str]
    results: dict[str, dict[str, BenchmarkFigure]]


class FigureChange(NamedTuple):
    """A figure that both have; `factor` above 1 is better."""

    name: str
    base: BenchmarkFigure
    new: BenchmarkFigure
    factor: float
    beyond: bool

    @property
    def worse(self) -> bool:
        """Return whether it lost more than either measurement wavers."""
        return self.beyond and self.factor < 1


def changes(base: Kept, new: Kept) -> list[FigureChange]:
    """Of all figures that both have, in their order."""
    found = []
    for bench, figures in new.results.items():
        for name, figure in figures.items():
            before = base.results.get(bench, {}).get(name)
            if before is not None:
                found.append(_change(f"{bench}: {name}", before, figure))
    return found


def main() -> None:
    """Print the changes; exit with 1 when something became worse."""
    if len(sys.argv) != 3:
        sys.stderr.write("compare takes two files that `make bench` kept: BASE.json NEW.json\n")
        raise SystemExit(2)
    try:
        base, new = (
            msgspec.json.decode(Path(name).read_bytes(), type=Kept) for name in sys.argv[1:]
        )
    except (OSError, msgspec.MsgspecError) as error:
        sys.stderr.write(f"compare cannot read a file that `make bench` kept: {error}\n")
        raise SystemExit(2) from None
    for key, value in new.machine.items():
        if key != "load" and base.machine.get(key) != value:
            sys.stdout.write(f"not the same {key}: {base.machine.get(key)} and {value}\n")
    found = changes(base, new)
    for change in found:
        mark = "WORSE" if change.worse else "better" if change.beyond else ""
        sys.stdout.write(
            f"{change.name:<52}{change.base.value:>12.4g}{change.new.value:>12.4g} "
            f"{change.new.unit:<8}{change.factor:>6.2f}  {mark}\n"
        )
    worse = sum(change.worse for change in found)
    sys.stdout.write(f"{len(found)} figures compared, {worse} worse beyond the spread\n")
    raise SystemExit(1 if worse else 0)


def _change(name: str, base: BenchmarkFigure, new: BenchmarkFigure) -> FigureChange:
    more = new.better == "more"
    factor = new.value / base.value if more else base.value / new.value
    (base_low, base_high), (new_low, new_high) = _spread(base), _spread(new)
    return FigureChange(name, base, new, factor, new_high < base_low or new_low > base_high)


def _spread(figure: BenchmarkFigure) -> tuple[float, float]:
    """Quartiles, or further out where they are nearer than runs are to each other."""
    low, high = (figure.value * (1 + sign * LEAST_SPREAD) for sign in (-1, 1))
    return min(figure.low, low), max(figure.high, high)


if __name__ == "__main__":
    main()
