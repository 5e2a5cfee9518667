"""The command line: every `concord` command by its name."""

import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Annotated, Literal

import tyro
from tyro.extras import SubcommandApp

from concord._version import __version__
from concord.disk import RunFailed
from concord.entries import chosen, entries
from concord.experiments.repeated_options import refuse_repeated
from concord.experiments.standard_output import prepare_streams, standard_output
from concord.experiments.user_errors import user_errors
from concord.scenarios.user.faults import user_faults
from concord.topology.names import unknown_name


def main(arguments: list[str] | None = None) -> None:
    """Run one command; exit code 2 for a mistake of the user, 1 for a failed run, 130 on Ctrl-C,
    141 if whoever reads what it prints has gone."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments == ["--version"]:
        arguments = ["version"]
    prepare_streams()
    try:
        command = _command(arguments[:1])
        with user_errors():
            refuse_repeated(arguments)
        # From here on there is something to clean up.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        # A polite end is an interruption: whatever cleans up after Ctrl-C cleans up then too.
        signal.signal(signal.SIGTERM, _interrupt)
        with standard_output(), user_faults():
            command(arguments)
    except RunFailed as error:
        sys.stderr.write(f"concord: {error}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        # All is cleaned up; a second one, from here on, would only change how we end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sys.stderr.write("interrupted\n")
        sys.exit(130)


def show_help(command: Annotated[tuple[str, ...], tyro.conf.Positional] = ()) -> None:
    """Explain concord or one of its commands.

    Args:
        command: A command, such as run or flexray plan; concord as a whole when left out.
    """
    main([*command, "--help"])


def print_version() -> None:
    """Print the version of concord, as `concord --version` does."""
    sys.stdout.write(f"concord {__version__}\n")


def print_completion(
    shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.Positional],
) -> None:
    """Print the script with which a shell completes commands and options.

    Args:
        shell: The shell that reads the script.
    """
    # The hyphen stands for standard output.
    main(["--tyro-write-completion", shell, "-"])


def _command(asked: list[str]) -> Callable[[list[str]], object]:
    """Return the command that is asked for, as a function of all arguments.

    It is one of all commands where none, an option or a group is asked for.
    """
    with user_errors():
        everything = entries("COMMANDS")
        if asked and asked[0] not in everything and not asked[0].startswith("-"):
            raise unknown_name("command", asked[0], everything)
        loaded = chosen("COMMANDS", asked[0]) if asked and asked[0] in everything else None
    if loaded is not None and not isinstance(loaded, dict):
        # Alone: a table of commands makes tyro load typeguard, for a tenth of a second.
        return lambda arguments: tyro.cli(loaded, prog=f"concord {asked[0]}", args=arguments[1:])
    return lambda arguments: _commands(asked).cli(
        prog="concord",
        description="Distributed consensus sensor networks on a FlexRay bus.",
        args=arguments,
    )


def _commands(asked: list[str]) -> SubcommandApp:
    """Return the group that is asked for, alone; all commands where none or an option is."""
    everything = entries("COMMANDS")
    commands = SubcommandApp()
    if asked in ([], ["-h"], ["--help"]):
        for name, entry in everything.items():
            commands.command(name=name, help=entry.summary)(_nothing)
        return commands
    for name in [name for name in asked if name in everything] or everything:
        loaded = chosen("COMMANDS", name)
        if isinstance(loaded, dict):
            group = SubcommandApp()
            for inner, function in loaded.items():
                group.command(function, name=inner)
            commands.command(group, name=name, help=everything[name].summary)
        else:
            commands.command(loaded, name=name)
    return commands


def _nothing() -> None:
    """Stand for a command of which only the summary is asked for."""


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
