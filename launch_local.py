"""Run a network on this machine: environment, one process per node, recorder.

    python launch_local.py --scenario target-tracking --nodes 8

The script takes every option of `concord run`, including --dashboard. It stops its processes on
Ctrl-C, SIGTERM or a crash.
"""

import sys

from concord.experiments.__main__ import main

if __name__ == "__main__":
    asked = sys.argv[1:]
    chosen = any(word.partition("=")[0] == "--driver" for word in asked)
    main(["run", *([] if chosen else ["--driver", "processes"]), *asked])
