"""The laboratory's command line: `python -m tests.laboratory PART ...`, or `make laboratory`."""

import sys
from importlib import import_module

import tyro

from concord.topology.names import unknown_name

# File and function of each part; a file is loaded when its part is asked for.
PARTS = {
    "drawn": ("seeds", "drawn"),
    "lives": ("seeds", "lives"),
    "kills": ("kills", "kills"),
    "overload": ("overload", "overload"),
    "fuzz": ("fuzz", "fuzz"),
    "mutants": ("mutants", "mutants"),
    "security": ("security", "security"),
    "bugs": ("bugs", "bugs"),
    "plants": ("own_plants", "plants"),
    "exact": ("exact", "exact"),
}


def main(arguments: list[str]) -> None:
    """Run a part; exit code 1 for a finding, 2 for a mistake of the user, 130 on Ctrl-C."""
    name = arguments[0] if arguments else "--help"
    if name in ("-h", "--help"):
        sys.stdout.write(f"{__doc__}\n\nParts: {', '.join(PARTS)}\n")
        return
    if name not in PARTS:
        sys.stderr.write(f"laboratory: {unknown_name('part', name, PARTS)}\n")
        sys.exit(2)
    file, function = PARTS[name]
    part = getattr(import_module(f"tests.laboratory.{file}"), function)
    try:
        tyro.cli(part, prog=f"python -m tests.laboratory {name}", args=arguments[1:])
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main(sys.argv[1:])
