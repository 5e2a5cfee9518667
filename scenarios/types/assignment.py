"""Scenarios as flat names and values, as the command line, sweeps and `set` commands say them."""

import math
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from concord.scenarios.types.declarations import (
    Declaration,
    Owned,
    declarations,
    every_option,
    is_nested,
)
from concord.scenarios.types.option import Choice, name_of
from concord.topology.names import unknown_name

Value = TypeVar("Value", bound=msgspec.Struct)


def flat(value: msgspec.Struct) -> dict[str, Any]:
    """All options of a value with what they are, choices by name, in the order of declaration."""
    found: dict[str, Any] = {}
    for declared in declarations(type(value)):
        held = getattr(value, declared.field)
        if is_nested(declared):
            found |= flat(held)
        elif declared.choices:
            found |= {declared.name: held.name, **flat(held)}
        elif _has(value, declared.says.needs, {}):
            found[declared.name] = held
    return found


def assigned(value: Value, asked: Mapping[str, Any]) -> tuple[Value, dict[str, Any]]:
    """The value with the options that were asked for, and those which it does not have.

    A choice is given by its name, or as the value itself. A value that is newly chosen keeps what
    it shares with the one before.

    Raises:
        ValueError: an unknown name, or a value of another type.
    """
    left = dict(asked)
    return _assigned(value, left), left


def _assigned(value: Any, left: dict[str, Any]) -> Any:
    changes: dict[str, Any] = {}
    for declared in declarations(type(value)):
        before = getattr(value, declared.field)
        if is_nested(declared):
            changes[declared.field] = _assigned(left.pop(declared.name, before), left)
        elif declared.choices:
            chosen = before
            if declared.name in left:
                chosen = _chosen(declared, before, left.pop(declared.name))
            changes[declared.field] = _assigned(chosen, left)
        elif declared.name in left and _has(value, declared.says.needs, changes):
            changes[declared.field] = typed(declared, left.pop(declared.name))
    return msgspec.structs.replace(value, **changes)


def _has(value: msgspec.Struct, flag: str, changes: Mapping[str, Any]) -> bool:
    """Whether a value has the flag that an option needs."""
    return not flag or bool(changes.get(flag, getattr(value, flag)))


def _chosen(declared: Declaration, before: Any, asked: object) -> Any:
    if isinstance(asked, declared.choices):
        return asked
    for choice in declared.choices:
        if name_of(choice) == asked:
            return before if type(before) is choice else choice(**_kept(choice, before))
        made = choice.made_of(asked) if issubclass(choice, Choice) else None
        if made is not None:
            return msgspec.structs.replace(made, **_kept(choice, before))
    name = asked.name if isinstance(asked, Choice) else str(asked)
    raise unknown_name(_in_words(declared.name), name, declared.names)


def _kept(choice: type[msgspec.Struct], before: Any) -> dict[str, Any]:
    """The fields of a class that it shares with the value that was chosen before."""
    known = {declared.field: declared for declared in declarations(type(before))}
    kept: dict[str, Any] = {}
    for declared in declarations(choice):
        if declared.field not in known:
            continue
        held = getattr(before, declared.field)
        if not declared.choices:
            if not declared.names or held in declared.names:
                kept[declared.field] = held
            continue
        same = [one for one in declared.choices if name_of(one) == held.name]
        if same:
            inner = same[0]
            kept[declared.field] = held if type(held) is inner else inner(**_kept(inner, held))
    return kept


def typed(declared: Declaration, value: object) -> Any:
    """The value as the type of its option.

    Raises:
        ValueError: it is of another type.
    """
    if declared.names and value not in declared.names:
        unknown = unknown_name(_in_words(declared.name), str(value), declared.names)
        cure = declared.says.cure
        raise ValueError(f"{unknown}; {cure}") if cure else unknown
    try:
        return msgspec.convert(value, declared.annotation)
    except msgspec.ValidationError:
        kinds = " or ".join(_KINDS.get(kind, str(kind)) for kind in declared.kinds)
        raise ValueError(f"{_flag(declared.name)} {value}: must be {kinds}") from None


_KINDS: dict[Any, str] = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    type(None): "none",
}


def check_ranges(value: msgspec.Struct) -> None:
    """Refuse numbers outside the range that their declaration gives.

    Raises:
        ValueError: naming the option, its value and the rule.
    """
    for declared in declarations(type(value)):
        held = getattr(value, declared.field)
        if declared.choices:
            check_ranges(held)
        elif isinstance(held, int | float) and not declared.says.holds(held):
            rule = declared.says.range
            rule = rule if math.isfinite(held) else f"{rule}, and finite"
            cure = declared.says.cure and f"; {declared.says.cure}"
            raise ValueError(f"{_flag(declared.name)} {held}: must be {rule}{cure}")


def refuse_left(root: msgspec.Struct, left: Mapping[str, Any]) -> None:
    """Refuse options that no chosen value of `root` has.

    Raises:
        ValueError: naming the option, its value, and the values that it belongs to.
    """
    every = list(every_option(type(root)))
    for option, value in left.items():
        owned = [one for one in every if one.declaration.name == option]
        if not owned:
            raise unknown_name("option", option, {one.declaration.name: 0 for one in every})
        owners = owners_in_words(owned, flat(root))
        raise ValueError(
            f"{_flag(option)} {value}: belongs to {owners}; leave it out, or choose that"
        )


def owners_in_words(owned: list[Owned], chosen: Mapping[str, Any]) -> str:
    """The choices that have an option: "--hold decayed of --rule ci, trimmed-ci or wac"."""
    groups: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for one in owned:
        names = groups.setdefault(tuple(option for option, _ in one.owners), {})
        for option, name in one.owners:
            if name not in names.setdefault(option, []):
                names[option].append(name)
    phrases = [_missing(names, chosen) for names in groups.values()]
    if not all(phrases):
        return _flag(owned[0].declaration.says.needs)
    return " or ".join(phrases)


def _missing(names: dict[str, list[str]], chosen: Mapping[str, Any]) -> str:
    """Return the choices of these names that are not made, the innermost first; "" for none."""
    return " of ".join(
        f"{_flag(option)} {_listed(values)}"
        for option, values in reversed(names.items())
        if chosen.get(option) not in values
    )


def _listed(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last


def _flag(option: str) -> str:
    return f"--{option.replace('_', '-')}"


def _in_words(option: str) -> str:
    return option.replace("_", " ")
