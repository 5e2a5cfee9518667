"""`make bench`: every benchmark in turn; each prints ratios measured in the same run."""

import argparse
import platform
import sys

import msgspec

from benchmarks import launch, lockstep, occupancy, set_membership

BENCHMARKS = {
    "launch": launch.main,
    "lockstep": lockstep.main,
    "occupancy": occupancy.main,
    "set-membership": set_membership.main,
}


def main() -> None:
    """Run the benchmarks that are named, or all; `--json` prints one object at the end."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", help=f"any of {', '.join(BENCHMARKS)}")
    parser.add_argument("--json", action="store_true", help="print one JSON object at the end")
    arguments = parser.parse_args()
    wrong = set(arguments.names) - set(BENCHMARKS)
    if wrong:
        parser.error(f"no benchmark {', '.join(wrong)}; there are {', '.join(BENCHMARKS)}")
    sys.stdout.write(f"{platform.machine()}, Python {platform.python_version()}\n")
    results = {name: BENCHMARKS[name]() for name in arguments.names or BENCHMARKS}
    if arguments.json:
        sys.stdout.write(msgspec.json.encode(results).decode() + "\n")


if __name__ == "__main__":
    main()
