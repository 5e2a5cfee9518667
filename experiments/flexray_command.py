"""`concord flexray`: recordings, clusters and plans of a FlexRay bus."""

from tyro.extras import SubcommandApp

from experiments.flexray_clusters import convert, validate
from experiments.flexray_plans import plan, show
from experiments.flexray_recordings import decode, fit

SUMMARY = "Recordings, clusters and plans of a FlexRay bus."
_COMMANDS = {
    "decode": decode,
    "fit": fit,
    "validate": validate,
    "plan": plan,
    "show": show,
    "convert": convert,
}


def flexray_commands() -> SubcommandApp:
    """The commands below `concord flexray`."""
    commands = SubcommandApp()
    for name, command in _COMMANDS.items():
        commands.command(command, name=name)
    return commands
