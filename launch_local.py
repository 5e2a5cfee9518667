"""Run a network on this machine: environment, one process per node, recorder.

    python launch_local.py --scenario target-tracking --nodes 8

The script is `concord run --driver processes`, and takes every option of it. It stops its processes
on Ctrl-C, SIGTERM or a crash.

Reason for a file of its own: users start it by its name.
"""

from concord.experiments.__main__ import main

PRESET = {"--driver": "processes"}
"""The options that differ from those of `concord run`; users may replace them."""

if __name__ == "__main__":
    main(program="launch_local.py", preset=PRESET)
