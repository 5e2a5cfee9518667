"""Read the declarations of options out of the classes of values that own them."""

import types
import typing
from collections.abc import Iterator
from functools import cache, reduce
from operator import or_
from typing import Any, NamedTuple

import msgspec

from concord.entries import entries, member
from concord.scenarios.types.option import USER, Option, name_of


class Declaration(NamedTuple):
    """One field of one class of values.

    Attributes:
        name: name of the option, without dashes in front.
        field: name of the field in its class.
        annotation: type of the field, without its description.
        members: the classes of a choice; empty for a plain value.
        says: meaning, range, unit and group.
        default: value of the field when nothing is said; `msgspec.NODEFAULT` where there is none.
    """

    name: str
    field: str
    annotation: Any
    choices: tuple[type[msgspec.Struct], ...]
    says: Option
    default: Any

    @property
    def names(self) -> tuple[str, ...]:
        """The names that a choice takes, or the words that a plain value may be."""
        if self.choices:
            names = (name_of(choice) for choice in self.choices)
            return tuple(name for name in names if name != USER)
        if typing.get_origin(self.annotation) is typing.Literal:
            return tuple(typing.get_args(self.annotation))
        return ()

    @property
    def kinds(self) -> tuple[Any, ...]:
        """The types that a plain value may have."""
        if isinstance(self.annotation, types.UnionType):
            return typing.get_args(self.annotation)
        return (self.annotation,)


@cache
def declarations(owner: type[msgspec.Struct]) -> tuple[Declaration, ...]:
    """The options that a class of values declares itself, in order; nested values count as its own
    unless they are a choice. A field that no `Option` describes is none."""
    found: list[Declaration] = []
    for info in msgspec.structs.fields(owner):
        if typing.get_origin(info.type) is not typing.Annotated:
            continue
        annotation, says = _described(info.type)
        choices = _choices(annotation)
        default = info.default
        if default is msgspec.NODEFAULT and info.default_factory is not msgspec.NODEFAULT:
            default = info.default_factory()
        name = says.flag or info.name
        found.append(Declaration(name, info.name, annotation, choices, says, default))
    return tuple(found)


class Owned(NamedTuple):
    """A declaration with the choices that lead to it: (option, name of the value) each."""

    declaration: Declaration
    owners: tuple[tuple[str, str], ...]
    group: str


def every_option(root: type[msgspec.Struct], group: str = "run") -> Iterator[Owned]:
    """All options below a class, those of a choice before those of its values. An option of several
    values is there once for each."""
    yield from _below(root, (), group)


def _below(
    owner: type[msgspec.Struct], owners: tuple[tuple[str, str], ...], group: str
) -> Iterator[Owned]:
    for declared in declarations(owner):
        own = declared.says.group or group
        if is_nested(declared):
            yield from _below(declared.choices[0], owners, own)
            continue
        yield Owned(declared, owners, own)
        for choice in declared.choices:
            yield from _below(choice, (*owners, (declared.name, name_of(choice))), own)


def is_nested(declared: Declaration) -> bool:
    """Whether the field is a value that has no other to choose from, and no name."""
    return len(declared.choices) == 1 and declared.choices[0].__struct_config__.tag is None


def _described(annotation: Any) -> tuple[Any, Option]:
    plain, *described = typing.get_args(annotation)
    return plain, next(one for one in described if isinstance(one, Option))


def _choices(annotation: Any) -> tuple[type[msgspec.Struct], ...]:
    kinds = (
        typing.get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    )
    if all(isinstance(kind, type) and issubclass(kind, msgspec.Struct) for kind in kinds):
        return tuple(kinds)
    return ()


def choice_of(
    kind: str,
    *others: type[msgspec.Struct],
    base: type[msgspec.Struct] | None = None,
) -> Any:
    """Return the union of the option classes of a kind's entries and of `others`.

    An entry without options gets a class of its own below `base`.

    Raises:
        ValueError: an entry without options, of a kind without a base.
    """
    found: list[type[msgspec.Struct]] = []
    for name, entry in entries(kind).items():
        if entry.options:
            found.append(member(entry.options))
        elif base is not None:
            made = msgspec.defstruct(
                name, [], bases=(base,), tag=name, frozen=True, kw_only=True,
                namespace={"__doc__": entry.summary},
            )  # fmt: skip
            found.append(made)
        else:
            raise ValueError(f"{kind.lower()} {name!r}: its entry names no options; add them")
    return reduce(or_, (*found, *others))
