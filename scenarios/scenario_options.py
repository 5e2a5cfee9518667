"""The options of a scenario: generated from the types that declare them, and what they mean."""

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

from concord.scenarios.catalogue import definition_named, definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.script import with_files
from concord.scenarios.types.assignment import check_ranges, flat, refuse_left
from concord.scenarios.types.declarations import Declaration, Owned, every_option

DEFAULT_SCENARIO = "target-tracking"
GROUPS = {
    "plant": "Simulated plant.",
    "network": "Nodes and who hears whom.",
    "rule": "How nodes fuse what they hear.",
    "bus": "How shares travel.",
    "filter": "How a node filters its readings.",
    "faults": "Faults of links and processes.",
    "run": "How long, and with which randomness.",
}
"""The headings of the help and of docs/options.md, in their order."""


class OfferedOption(NamedTuple):
    """An option by its name, with the declarations of all values that have it."""

    name: str
    owned: tuple[Owned, ...]

    @property
    def declaration(self) -> Declaration:
        """The first declaration; others differ in their names or defaults alone."""
        return self.owned[0].declaration

    @property
    def group(self) -> str:
        """The heading under which `--help` shows the option."""
        return self.owned[0].group

    @property
    def names(self) -> tuple[str, ...]:
        """All names that the option takes; empty for numbers and free texts."""
        return tuple(dict.fromkeys(name for one in self.owned for name in one.declaration.names))

    @property
    def kinds(self) -> tuple[Any, ...]:
        """The types that its value may have."""
        return (str,) if self.names else self.declaration.kinds

    @property
    def is_choice(self) -> bool:
        """Whether its values have options in turn."""
        return bool(self.declaration.choices)

    @property
    def owners(self) -> str:
        """The choices that have the option: "--rule ci, wac"; "" where every scenario has it."""
        found: dict[str, list[str]] = {}
        for one in self.owned:
            if not one.owners:
                return ""
            choice, name = one.owners[-1]
            found.setdefault(choice, [])
            if name not in found[choice]:
                found[choice].append(name)
        if all({*offered_options()[choice].names} <= {*names} for choice, names in found.items()):
            return ""
        return "; ".join(f"--{choice} {', '.join(names)}" for choice, names in found.items())

    @property
    def default(self) -> Any:
        """Its value when nothing is said, in the default scenario where that has the option."""
        usual = flat(definition_named(DEFAULT_SCENARIO).defaults)
        return usual.get(self.name, self.declaration.default)

    @property
    def help(self) -> str:
        """Meaning, names, unit, range and owners of the option."""
        says = self.declaration.says
        text = says.text.removesuffix(".")
        if self.names and not says.text.count(","):
            text += f": {', '.join(self.names)}"
        facts = [f"in {says.unit}"] if says.unit else []
        if says.range != "finite":
            facts.append(says.range)
        if self.owners:
            facts.append(f"for {self.owners}")
        return f"{text}." + (f" ({'; '.join(facts)})" if facts else "")


def standing(asked: Mapping[str, str]) -> Callable[[OfferedOption], tuple[str, bool]]:
    """Return a function that tells how an option stands beside the values that are asked for.

    It returns the default in words, and whether the short help shows the option: a usual one, or
    one of a value that is asked for.

    Raises:
        ValueError: an unknown name of a value.
    """
    usual = definition_named(asked.get("scenario", DEFAULT_SCENARIO)).defaults
    options = offered_options()
    choices = {n: name for n, name in asked.items() if n in options and options[n].is_choice}
    chosen = flat(usual.with_known(**choices)[0])
    defaults = chosen | {name: flat(usual).get(name) for name in choices}

    def stands(option: OfferedOption) -> tuple[str, bool]:
        value = defaults.get(option.name, option.declaration.default)
        words = {None: "computed", (): "none"}.get(value, value)
        here = [
            one
            for one in option.owned
            if all(chosen.get(choice) == name for choice, name in one.owners if choice in choices)
        ]
        is_asked_for = any(
            any(choice in choices for choice, _ in one.owners)
            and all(chosen.get(choice) == name for choice, name in one.owners)
            for one in here
        )
        is_usual = any(one.declaration.says.first for one in here)
        return f"(default: {words})", is_usual or is_asked_for

    return stands


@cache
def offered_options() -> dict[str, OfferedOption]:
    """Every option of a scenario by its name, group by group in the order of declaration."""
    found: dict[str, list[Owned]] = {}
    for one in every_option(Scenario):
        found.setdefault(one.declaration.name, []).append(one)
    options = [OfferedOption(name, tuple(owned)) for name, owned in found.items()]
    return {one.name: one for group in GROUPS for one in options if one.group == group}


def scenario_of(scenario: str = DEFAULT_SCENARIO, **options: Any) -> Scenario:
    """The scenario of that name with the options that were asked for, nothing left open.

    Raises:
        ValueError: there is no such scenario or option, a value that is not chosen has the option,
            or its data cannot be read.
    """
    found, left = scenario_with_known(scenario, **options)
    refuse_left(found, left)
    check_ranges(found)
    return found


def scenario_with_known(
    scenario: str = DEFAULT_SCENARIO, **options: Any
) -> tuple[Scenario, dict[str, Any]]:
    """As `scenario_of`, and the options that no chosen value has.

    Raises:
        ValueError: there is no such scenario, or its data cannot be read.
    """
    if "changes" in options:
        options = {**options, "changes": with_files(options["changes"])}
    found, left = definition_named(scenario).defaults.with_known(**options)
    definition = definition_of(found)
    if definition.all_steps is not None and "steps" not in options:
        found = found.with_(steps=definition.all_steps(found))
    return found, left


def in_options(scenario: Scenario) -> list[str]:
    """The words of the command line that say a scenario of a name, without its defaults."""
    definition, chosen = definition_of(scenario), flat(scenario)
    usual = definition.defaults
    is_choice = {name: offered_options()[name].is_choice for name in chosen}
    choices = {name: value for name, value in chosen.items() if is_choice[name]}
    before, with_choices = flat(usual), flat(usual.with_known(**choices)[0])

    if definition.all_steps is not None and scenario != usual:
        # A command that names no steps takes all of the log, whatever the default is.
        with_choices["steps"] = definition.all_steps(scenario)
    words: list[str] = []
    for name, value in chosen.items():
        if value != (before if is_choice[name] else with_choices).get(name):
            words += _words_of(name, value)
    return words


def _words_of(name: str, value: Any) -> Iterator[str]:
    option = name.replace("_", "-")
    if isinstance(value, bool):
        yield f"--{option}" if value else f"--no-{option}"
        return
    yield f"--{option}"
    yield from value if isinstance(value, tuple) else (str(value),)
