"""Print what breaks the house rules: `python -m tests.house`."""

import sys

from tests.house.rules import RULES
from tests.house.sources import product


def main() -> int:
    """Try every rule on the product; return the exit code."""
    sources = product()
    found = 0
    for rule in RULES:
        complaints = list(rule(sources))
        found += len(complaints)
        sys.stdout.write(f"{rule.__name__}: {len(complaints)}\n")
        sys.stdout.writelines(f"  {complaint}\n" for complaint in complaints)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
