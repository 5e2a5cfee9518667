"""`make bench`: every benchmark in turn; each prints ratios measured in the same run."""

import argparse
import importlib
import sys
from pathlib import Path

import msgspec

from benchmarks.compare import Kept
from benchmarks.measure import BenchmarkFigures, machine, peak_mb, say, table
from benchmarks.picture import draw

# Modules with a `main() -> Figures`; loaded when they are run, as some need much.
BENCHMARKS = {
    "ukf": "ukf",
    "fusion": "fusion",
    "monte-carlo": "monte_carlo",
    "scale": "scale",
    "association": "association",
    "share": "share",
    "node": "node_loop",
    "launch": "launch",
    "lockstep": "lockstep",
    "ladder": "ladder",
    "workers": "workers",
    "commands": "commands",
    "set-membership": "set_membership",
    "dashboard": "dashboard",
}
KEPT = Path("runs/bench.json")


def main() -> None:
    """Run the benchmarks that are named, or all, and keep their figures."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", help=f"any of {', '.join(BENCHMARKS)}")
    parser.add_argument("--json", action="store_true", help="print one JSON object at the end")
    parser.add_argument("--output", type=Path, default=KEPT, help="where figures are kept")
    parser.add_argument("--picture", type=Path, help="also draw the figures (PNG)")
    arguments = parser.parse_args()
    if wrong := set(arguments.names) - set(BENCHMARKS):
        parser.error(f"no benchmark {', '.join(wrong)}; there are {', '.join(BENCHMARKS)}")
    about = machine()
    say("; ".join(f"{name} {value}" for name, value in about.items()))
    results: dict[str, BenchmarkFigures] = {}
    for name in arguments.names or BENCHMARKS:
        results[name] = importlib.import_module(f"benchmarks.{BENCHMARKS[name]}").main()
        # Kept at once: a later one may fail.
        _keep(Kept(about, results), arguments.output)
    about["load"] += f" at the start, {machine()['load']} at the end"
    _keep(Kept(about, results), arguments.output)
    say("\n" + table(results))
    say(f"\nload {about['load']}; peak memory {peak_mb():.0f} MB; kept in {arguments.output}")
    if arguments.picture:
        draw(results, arguments.picture)
    if arguments.json:
        sys.stdout.write(msgspec.json.encode(results).decode() + "\n")


def _keep(kept: Kept, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(msgspec.json.format(msgspec.json.encode(kept)))


if __name__ == "__main__":
    main()
