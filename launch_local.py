"""Run a network on this machine: environment, one process per node, recorder.

    python launch_local.py --scenario target-tracking --nodes 8

The script takes every option of `concord run`, including --dashboard. It stops its processes on
Ctrl-C, SIGTERM or a crash. Unless options choose a bus, a quarter of the nodes publish in a cycle,
by urgency, in two bytes a number, and average by the rule `sharp-ci`: the network of `make demo`.

Reason for a file of its own: users start it by its name.
"""

import sys
from collections.abc import Sequence

from concord.experiments.__main__ import main

_BUS = {"--schedule", "--occupancy", "--bus", "--cluster", "--arbiter", "--trigger"}
_LIMITED = ("--schedule", "dynamic", "--occupancy", "0.25")
_RULE = ("--rule", "sharp-ci", "--number", "float16")


def with_defaults(asked: Sequence[str]) -> list[str]:
    """Return the words of `concord run` for those of this script.

    Scenarios other than the tracking of a target bring a bus of their own.
    """
    words = [part for word in asked for part in word.split("=", 1)]
    names = set(words)
    found = list(asked)
    scenario = words[words.index("--scenario") + 1 :][:1] if "--scenario" in names else []
    if not names & _BUS and scenario in ([], ["target-tracking"], ["target-crossing"]):
        found = [*_LIMITED, *([] if names & {"--rule", "--number"} else _RULE), *found]
    return found if "--driver" in names else ["--driver", "processes", *found]


if __name__ == "__main__":
    main(["run", *with_defaults(sys.argv[1:])])
