"""The house rules that look at all files of the product together."""

from collections.abc import Callable, Iterator, Sequence

from tests.house.dead_code import functions_are_called, modules_are_reached
from tests.house.features import (
    entries_import_nothing,
    features_need_what_they_name,
    the_core_names_no_feature,
)
from tests.house.names import aliases_have_one_definition, class_names_are_unique
from tests.house.sources import Source
from tests.house.structure import (
    classes_are_small,
    folders_are_small,
    no_import_circles,
    small_files_have_a_reason,
)

Rule = Callable[[Sequence[Source]], Iterator[str]]
RULES: tuple[Rule, ...] = (
    no_import_circles,
    folders_are_small,
    classes_are_small,
    small_files_have_a_reason,
    the_core_names_no_feature,
    features_need_what_they_name,
    entries_import_nothing,
    class_names_are_unique,
    aliases_have_one_definition,
    modules_are_reached,
    functions_are_called,
)
