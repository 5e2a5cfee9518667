"""Print what breaks the house rules, and the sizes: `python -m tests.house [--set-budget]`.

With `--set-budget`, the present count of each folder becomes its budget.
"""

import sys

from tests.house.rules import RULES
from tests.house.sizes import budget_findings, budgets, counted, set_budgets, table
from tests.house.sources import product


def main(arguments: list[str]) -> int:
    """Try every rule on the product; return the exit code."""
    if arguments == ["--set-budget"]:
        set_budgets()
    elif arguments:
        sys.stderr.write(f"{' '.join(arguments)}: the only option is --set-budget\n")
        return 2
    found = {rule.__name__: list(rule(product())) for rule in RULES}
    found["folders_keep_their_budgets"] = list(budget_findings(counted(), budgets()))
    for name, complaints in found.items():
        sys.stdout.write(f"{name}: {len(complaints)}\n")
        sys.stdout.writelines(f"  {complaint}\n" for complaint in complaints)
    sys.stdout.write("\n" + "\n".join(table()) + "\n")
    return 1 if any(found.values()) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
