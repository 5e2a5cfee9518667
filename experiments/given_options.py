"""The options that a command names; one that it names twice is refused, as the parser keeps one."""

import re
from collections.abc import Iterator, Sequence

HELP = ("-h", "--help", "--help-all")
_OPTION = re.compile(r"(--[A-Za-z][\w-]*)(?:=(.*))?|(-[A-Za-z])=?(.*)", re.DOTALL)
_NUMBERS = ("-inf", "-infinity", "-nan")
_LONG = {"-o": "--out"}
# In these commands each option of a scenario takes a comma list.
_LISTING = ("sweep", "design")


def given_options(arguments: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield each option by its name, as it is written, and with the words up to the next one.

    --NAME and --no-NAME are one option.
    """
    option, words = "", []
    for word in (*arguments, "--"):
        found = None if word.lower() in _NUMBERS else _OPTION.fullmatch(word)
        if found is None and word != "--":
            words.append(word)
            continue
        if option:
            name = _LONG.get(option, option).replace("_", "-").replace("--no-", "--", 1)
            yield name, option, " ".join(words)
        if found is None:
            return
        option, words = found[1] or found[3], [text for text in (found[2], found[4]) if text]


def refuse_repeated(arguments: Sequence[str]) -> None:
    """Refuse a command that names an option twice.

    Raises:
        ValueError: naming the option, both values and the cure.
    """
    given: dict[str, tuple[str, str]] = {}
    for name, option, value in given_options(arguments):
        if name in given:
            before = " ".join(given[name]).strip()
            cure = "give it once"
            if arguments[0] in _LISTING and _is_of_scenario(name):
                cure = f"write {name} {given[name][1]},{value}"
            raise ValueError(
                f"{name} is given twice, {before} and {f'{option} {value}'.strip()}, and only one "
                f"of them can hold; {cure}"
            )
        given[name] = option, value


def _is_of_scenario(name: str) -> bool:
    # Only here: most commands do without the scenarios, which take time to load.
    from concord.scenarios.scenario_options import offered_options

    return name.removeprefix("--").replace("-", "_") in offered_options()
