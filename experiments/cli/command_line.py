"""The command line: every `concord` command by its name."""

import difflib
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import FrameType
from typing import Annotated, Any, Literal

import tyro
from tyro import _errors as tyro_errors
from tyro.extras import SubcommandApp

from concord._version import __version__
from concord.disk import RunFailed
from concord.entries import chosen, entries
from concord.experiments.cli import help as help_pages
from concord.experiments.given_options import HELP, given_options, refuse_repeated
from concord.experiments.standard_output import prepare_streams, standard_output
from concord.experiments.user_errors import user_errors
from concord.scenarios.user.faults import user_faults
from concord.topology.names import unknown_name

_ONCE_MORE_S = 0.02
_KINDS = {int: "a whole number", float: "a number"}


def main(
    arguments: Sequence[str] | None = None,
    program: str = "",
    preset: Mapping[str, str] | None = None,
) -> None:
    """Run one command; exit code 2 for a mistake of the user, 1 for a failed run, 130 on Ctrl-C,
    141 if whoever reads what it prints has gone.

    A `program` of its own is `concord run` with a `preset` of options that users may replace.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    preset = preset or {}
    if program:
        named = {name for name, _, _ in given_options(words)}
        options = [word for name in preset if name not in named for word in (name, preset[name])]
        words = ["run", *options, *words]
    if words == ["--version"]:
        words = ["version"]
    prepare_streams()
    try:
        with standard_output():
            _run(words, program, preset)
    except RunFailed as error:
        sys.stderr.write(f"concord: {error}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        # All is cleaned up; a second one, from here on, would only change how we end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sys.stderr.write("interrupted\n")
        sys.exit(130)


def _run(words: list[str], program: str, preset: Mapping[str, str]) -> None:
    """Run the command that words name, or show its help."""
    if not words or words[0] in HELP:
        sys.stdout.write(help_pages.commands_help("--help-all" in words))
        sys.exit(0)
    with user_errors():
        command, named = _command(words)
        program = program or f"concord {' '.join(words[:named])}"
        words = words[named:]
        before = words[: words.index("--")] if "--" in words else words
        asked = [word for word in HELP if word in before]
        if isinstance(command, dict):
            if words and words[0] not in HELP:
                raise unknown_name(f"command of {program}", words[0], command)
            sys.stdout.write(help_pages.group_help(program, command))
            sys.exit(0)
        if asked:
            given = {name: value for name, _, value in given_options(words) if value}
            everything = "--help-all" in asked
            shown = help_pages.command_help(program, command, given, preset, everything)
            sys.stdout.write(shown)
            sys.exit(0)
        refuse_repeated([program.removeprefix("concord "), *words])
    # From here on there is something to clean up.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # A polite end is an interruption: whatever cleans up after Ctrl-C cleans up then too.
    signal.signal(signal.SIGTERM, _interrupt)
    sys.unraisablehook = _interrupted_callback
    with tyro_errors.on_parse_error(partial(_refuse, command)), user_faults():
        tyro.cli(command, prog=program, args=words, add_help=False)


def _interrupted_callback(found: "sys.UnraisableHookArgs") -> None:
    """Ask for an interruption once more where it fell into a callback, which cannot pass it on."""
    if issubclass(found.exc_type, KeyboardInterrupt):
        ask = threading.Timer(_ONCE_MORE_S, os.kill, (os.getpid(), signal.SIGINT))
        ask.daemon = True
        ask.start()
    else:
        sys.__unraisablehook__(found)


def _command(words: Sequence[str]) -> tuple[Any, int]:
    """Return the command that words begin with, or a group of them, and how many words name it.

    Raises:
        ValueError: there is none.
    """
    everything = entries("COMMANDS")
    if words[0] not in everything:
        raise unknown_name("command", words[0], everything)
    loaded = chosen("COMMANDS", words[0])
    if isinstance(loaded, dict) and words[1:2] and words[1] in loaded:
        return loaded[words[1]], 2
    return loaded, 1


def show_help(
    command: Annotated[tuple[str, ...], tyro.conf.Positional] = (), all: bool = False
) -> None:
    """Explain concord or one of its commands.

    Args:
        command: A command, such as run or flexray plan; concord as a whole when left out.
        all: Show all commands, or all options of the command.
    """
    main([*command, "--help-all" if all else "--help"])


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
    commands = SubcommandApp()
    for name, entry in entries("COMMANDS").items():
        loaded = chosen("COMMANDS", name)
        if isinstance(loaded, dict):
            group = SubcommandApp()
            for inner, function in loaded.items():
                group.command(function, name=inner)
            commands.command(group, name=name, help=entry.summary)
        else:
            commands.command(loaded, name=name)
    # The hyphen stands for standard output.
    commands.cli(prog="concord", args=["--tyro-write-completion", shell, "-"])


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _refuse(command: Callable[..., object], event: tyro_errors.ParseErrorEvent) -> None:
    """Say in one sentence what is wrong with the words of a command, and end with exit code 2."""
    with user_errors():
        raise ValueError(_sentence(command, event))


def _sentence(command: Callable[..., object], event: tyro_errors.ParseErrorEvent) -> str:
    more = f"`{event.prog} -h` explains it"
    match event:
        case tyro_errors.InvalidChoice(argument=argument, value=value, choices=choices):
            return str(unknown_name(_name(argument).removeprefix("--"), value, choices))
        case tyro_errors.InstantiationFailure(argument=argument, message=message) if argument:
            values = [value for _, value in re.findall(r"(['\"])(.*?)\1", message)]
            wrong = [value for value in values if not value.isdecimal()] or values
            meanings = filter(None, map(_KINDS.get, help_pages.kinds(argument.field.type)))
            must = " or ".join(meanings) or "of another form"
            return f"{_name(argument)} {wrong[0]}: must be {must}; {more}"
        case tyro_errors.BadValue(argument=argument):
            return f"{_name(argument)}: its value is missing; {more}"
        case tyro_errors.MissingArgs(missing_arguments=missing):
            return f"{_name(missing[0].arg)} is missing; {more}"
        case tyro_errors.UnrecognizedArgs(tokens=[token, *_]):
            near = difflib.get_close_matches(token, help_pages.option_names(command), 1, 0.7)
            offer = f": did you mean {near[0]}?" if near else ";"
            return f"{event.prog} has no {token}{offer} `{event.prog} --help-all` has all options"
    return f"{event.prog}: its words do not go together; {more}"


def _name(argument: Any) -> str:
    """Return an option as users write it, or a word as the help names it."""
    if argument.is_positional():
        return argument.field.argconf.metavar or argument.field.intern_name.upper()
    return argument.lowered.name_or_flags[-1]
