"""The command line: every `concord` command by its name, `flexray` with its own."""

import signal
import sys
from types import FrameType

from tyro.extras import SubcommandApp

from experiments.agree_command import agree
from experiments.collect_command import collect
from experiments.control_command import control
from experiments.dashboard_command import dashboard
from experiments.design_command import design
from experiments.doctor_command import doctor
from experiments.flexray_command import SUMMARY, flexray_commands
from experiments.host_commands import node, router, setup, world
from experiments.identify_command import identify_tyres
from experiments.keys_command import keys
from experiments.list_command import list_all
from experiments.plot_command import plot
from experiments.replay_command import replay
from experiments.report_command import report
from experiments.reproduce_command import reproduce
from experiments.run_command import run
from experiments.sweep_command import sweep
from experiments.topology_command import SUMMARY as TOPOLOGY_SUMMARY
from experiments.topology_command import topology_commands
from experiments.torture_command import torture
from nodes.disk import NotWritten

COMMANDS = {
    "run": run,
    "collect": collect,
    "dashboard": dashboard,
    "replay": replay,
    "control": control,
    "list": list_all,
    "agree": agree,
    "reproduce": reproduce,
    "identify": identify_tyres,
    "sweep": sweep,
    "design": design,
    "plot": plot,
    "report": report,
    "keys": keys,
    "setup": setup,
    "router": router,
    "world": world,
    "node": node,
    "doctor": doctor,
    "torture": torture,
}


def main(arguments: list[str] | None = None) -> None:
    """Run one command; exit code 2 for a mistake of the user, 1 for a failed run, 130 on Ctrl-C."""
    commands = SubcommandApp()
    for name, command in COMMANDS.items():
        commands.command(command, name=name)
    commands.command(flexray_commands(), name="flexray", help=SUMMARY)
    commands.command(topology_commands(), name="topology", help=TOPOLOGY_SUMMARY)
    try:
        # A polite end is an interruption: whatever cleans up after Ctrl-C cleans up then too.
        signal.signal(signal.SIGTERM, _interrupt)
        commands.cli(
            prog="concord",
            description="Distributed consensus sensor networks on a FlexRay bus.",
            args=arguments,
        )
    except NotWritten as error:
        sys.stderr.write(f"concord: {error}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        # All is cleaned up; a second one, from here on, would only change how we end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sys.stderr.write("interrupted\n")
        sys.exit(130)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
