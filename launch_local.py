"""A network on this machine in one command: world, one process per node, recorder.

    python launch_local.py --scenario target-tracking --nodes 8

Takes every option of `concord run`, --dashboard among them; stops what it started on Ctrl-C,
SIGTERM or a crash.
"""

import sys

from experiments.__main__ import main

if __name__ == "__main__":
    main(["run", "--driver", "processes", *sys.argv[1:]])
