"""The house rules that look at all files of the product together."""

from collections.abc import Callable, Iterator, Sequence

from tests.house.dead_code import functions_are_called, modules_are_reached
from tests.house.names import aliases_have_one_definition, class_names_are_unique
from tests.house.sources import Source
from tests.house.structure import classes_are_small, folders_are_small, no_import_circles

Rule = Callable[[Sequence[Source]], Iterator[str]]
RULES: tuple[Rule, ...] = (
    no_import_circles,
    folders_are_small,
    classes_are_small,
    class_names_are_unique,
    aliases_have_one_definition,
    modules_are_reached,
    functions_are_called,
)
