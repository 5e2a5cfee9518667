"""The help: commands by their doors, and the options of a command, the usual ones first."""

import ast
import inspect
import re
import shutil
import textwrap
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from concord.entries import DOORS, entries

FIRST = "first"
"""Marks an option of a command for its short help; a command without marks shows all of its own."""
_MOST_WIDTH = 100
_FLAGS_WIDTH, _TEXT_WIDTH = 22, 58
_METAVARS = {int: "INT", float: "FLOAT", Path: "PATH"}
_ARGUMENT = re.compile(r"^ {8}(\w+): (.*?)(?=^ {8}\w+: |^ {4}\w|\Z)", re.MULTILINE | re.DOTALL)
_WORDS, _OWN = "Words.", "This command."
"""Headings of what is no option of a scenario."""


class ShownOption(NamedTuple):
    """An option as the help shows it: its flags, text, default in words and heading."""

    flags: str
    text: str
    default: str
    group: str = _OWN
    is_first: bool = False


# --- commands -------------------------------------------------------------------------------------


def commands_help(everything: bool) -> str:
    """Return the commands by their doors.

    They have twelve lines of 80 columns: the first command of each door with its summary, the
    others by name. With `everything` each has its summary.
    """
    if everything:
        parts = []
        for door, names in _by_door(DOORS).items():
            rows = [ShownOption(name, entries("COMMANDS")[name].summary, "") for name in names]
            parts.append(f"{door}\n" + _rows(rows))
        return "\n".join((*parts, "concord COMMAND -h explains a command.\n"))
    lines = ["concord simulates networks of sensors that agree on what they observe."]
    for door, (first, *others) in _by_door(DOORS[:-1]).items():
        summary = _shortened(entries("COMMANDS")[first].summary, 80 - 24)
        lines.append(f"{door:<15}{first:<9}{summary}")
        if others:
            lines.append(f"{'':15}{' '.join(others)}")
    lines.append("concord run           begins; without options, a network tracks a target")
    lines.append("concord COMMAND -h    explains a command; concord help --all, every command")
    return "\n".join(lines) + "\n"


def group_help(program: str, commands: Mapping[str, Callable[..., object]]) -> str:
    """Return the commands of a group."""
    rows = [ShownOption(name, _paragraph(found), "") for name, found in commands.items()]
    return f"usage: {program} COMMAND [OPTIONS]\n\n{_rows(rows)}"


def _by_door(doors: tuple[str, ...]) -> dict[str, list[str]]:
    commands = entries("COMMANDS")
    found = {door: [name for name in commands if commands[name].door == door] for door in doors}
    return {door: names for door, names in found.items() if names}


# --- options of a command -------------------------------------------------------------------------


def command_help(
    program: str,
    command: Callable[..., object],
    given: Mapping[str, str],
    preset: Mapping[str, str],
    everything: bool,
) -> str:
    """Return the help of a command: its usual options in at most two lines each, or all of all.

    Args:
        program: name of the command in the usage.
        command: its function.
        given: options on the same line, by name; those of the values that they choose are shown.
        preset: options that the program gives itself: the true defaults.
        everything: whether all options are shown, group by group.

    Raises:
        ValueError: an unknown name among the given values.
    """
    options = _options(command, given, preset)
    words = [option for option in options if option.group == _WORDS]
    text = _paragraph(command)
    usage = " ".join((program, *(word.flags for word in words), "[OPTIONS]"))
    parts = [f"usage: {usage}\n", _filled(text if everything else _shortened(text, 150)) + "\n"]
    if not everything:
        shown = [
            option._replace(
                text=_shortened(option.text, 2 * _TEXT_WIDTH - len(option.default) - 10)
            )
            for option in options
            if option.is_first or option in words
        ]
        more = f"{program} --help-all explains all {len(options)} options.\n"
        return "\n".join((*parts, _rows(shown) + (more if len(shown) < len(options) else "")))
    for group in dict.fromkeys(option.group for option in options):
        rows = [option for option in options if option.group == group]
        parts.append(f"{group}\n{_rows(rows)}")
    return "\n".join(parts)


def option_names(command: Callable[..., object]) -> list[str]:
    """Return the names of all options of a command."""
    flags = " ".join(option.flags for option in _options(command, {}, {}))
    return re.findall(r"--[a-z][a-z0-9-]*", flags)


def _options(
    command: Callable[..., object], given: Mapping[str, str], preset: Mapping[str, str]
) -> list[ShownOption]:
    """Return the options of a command, those of a scenario first, and its positional words."""
    own, of_scenario = [], []
    for name, annotation, default, text in _parameters(command):
        lists_of_values = getattr(annotation, "lists_of_values", None)
        if lists_of_values is None:
            default = preset.get(_option(name), default)
            own.append(_own_option(name, annotation, default, text))
        else:
            of_scenario = list(scenario_options(lists_of_values, given))
    if not any(option.is_first for option in own):
        own = [option._replace(is_first=True) for option in own]
    return [*of_scenario, *own]


def scenario_options(lists_of_values: bool, given: Mapping[str, str]) -> Iterator[ShownOption]:
    """Yield the options of a scenario with the defaults that hold for the chosen values."""
    # Only here: most commands do without the scenarios, which take time to load.
    from concord.scenarios.scenario_options import GROUPS, offered_options, standing

    asked = {name.removeprefix("--").replace("-", "_"): value for name, value in given.items()}
    stand = standing({} if lists_of_values else asked)
    for option in offered_options().values():
        if lists_of_values and option.name == "run":
            continue  # A sweep numbers its runs itself.
        name, kind = _option(option.name), option.kinds[0]
        flags = f"{name} {'A,B,..' if lists_of_values else _METAVARS.get(kind, 'TEXT')}"
        if kind is bool and not lists_of_values:
            flags = f"{name}, --no-{name[2:]}"
        default, is_first = stand(option)
        yield ShownOption(flags, option.help, default, GROUPS[option.group], is_first)


def _own_option(name: str, annotation: Any, default: Any, text: str) -> ShownOption:
    kind, *extras = typing.get_args(annotation) if _is_described(annotation) else (annotation,)
    settings = next((extra for extra in extras if hasattr(extra, "aliases")), None)
    metavar, aliases = getattr(settings, "metavar", None), getattr(settings, "aliases", None)
    found = [one for one in kinds(kind) if one is not type(None)]
    names = [one for one in found if isinstance(one, str)]
    text = getattr(settings, "help", None) or " ".join(text.split())
    if not all(word in text for word in names):
        text = f"{text.removesuffix('.')}: {', '.join(names)}."
    shown = "(required)" if default is MISSING else f"(default: {default})"
    if any(repr(extra) == "Positional" for extra in extras):
        return ShownOption(metavar or name.upper(), text, "", _WORDS)
    if found == [bool]:
        flags = f"--no-{name.replace('_', '-')}" if default else _option(name)
    else:
        metavar = metavar or ("NAME" if names else _METAVARS.get(found[0], "TEXT"))
        flags = ", ".join((*(aliases or ()), f"{_option(name)} {metavar}"))
    shown = "" if default in (None, (), False, True, "") else shown
    return ShownOption(flags, text, shown, _OWN, FIRST in extras)


def _parameters(command: Callable[..., object]) -> Iterator[tuple[str, Any, Any, str]]:
    """Yield name, annotation, default and text of all that a command takes."""
    texts = dict(_ARGUMENT.findall(command.__doc__ or ""))
    hints = typing.get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        owner = typing.get_args(hints[name])[0] if _is_described(hints[name]) else hints[name]
        if not isinstance(owner, type) or not is_dataclass(owner):
            empty = parameter.default is inspect.Parameter.empty
            yield name, hints[name], MISSING if empty else parameter.default, texts.get(name, "")
        elif hasattr(owner, "lists_of_values"):
            yield name, owner, None, ""
        else:
            inner, below = typing.get_type_hints(owner, include_extras=True), _texts(owner)
            for one in fields(owner):
                yield one.name, inner[one.name], one.default, below.get(one.name, "")


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _is_described(annotation: Any) -> bool:
    return typing.get_origin(annotation) is typing.Annotated


def kinds(kind: Any) -> Iterator[Any]:
    """Yield the types, or the words, that a value may have."""
    inner = typing.get_args(kind)
    for one in inner or (kind,):
        yield from kinds(one) if inner and not isinstance(one, str) else (one,)


def _texts(owner: type) -> dict[str, str]:
    """Return the text below each field of a class and of those that it extends."""
    found: dict[str, str] = {}
    for one in reversed(owner.__mro__[:-1]):
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(one))).body
        assert isinstance(tree, ast.ClassDef)
        for before, below in pairwise(tree.body):
            match before, below:
                case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                    found[name] = text
    return found


# --- lines ----------------------------------------------------------------------------------------


def _paragraph(command: Callable[..., object]) -> str:
    """Return the first paragraph of a docstring as one line."""
    return " ".join(inspect.cleandoc(command.__doc__ or "").partition("\n\n")[0].split())


def _rows(options: list[ShownOption]) -> str:
    """Return a line or more for each option: its flags, and its text beside them or below."""
    lines = []
    for option in options:
        begin = f"  {option.flags}"
        text = f"{option.text} {option.default}".strip()
        if len(begin) > _FLAGS_WIDTH - 2:
            lines.append(begin)
            begin = ""
        lines.append(_filled(text, begin.ljust(_FLAGS_WIDTH), " " * _FLAGS_WIDTH))
    return "\n".join(lines) + "\n"


def _filled(text: str, begin: str = "", further: str = "") -> str:
    width = min(shutil.get_terminal_size().columns, _MOST_WIDTH)
    return textwrap.fill(
        text, width, initial_indent=begin, subsequent_indent=further,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _shortened(text: str, room: int) -> str:
    """Return as many whole sentences, or else parts of the first, as have room."""
    if len(text) <= room:
        return text
    ends = [found.start() for found in re.finditer(r"[.;:,](?= )", text[: room - 3])]
    if not ends:
        return text[: room - 4].rpartition(" ")[0] + " ..."
    sentences = [end for end in ends if text[end] == "."]
    if sentences:
        return text[: sentences[-1] + 1]
    return text[: ends[-1]] + (", ..." if text[ends[-1]] == "," else ".")
