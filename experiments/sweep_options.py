"""Every option of a scenario as one that takes several values."""

from typing import TYPE_CHECKING

from concord.experiments.scenario_flags import grouped_flags, texts

if TYPE_CHECKING:

    class FieldOptions:
        """A text or None for each option of a scenario, group by group."""

else:
    FieldOptions = grouped_flags(
        "FieldOptions",
        "What is swept: comma lists (ring,path) or, for whole numbers, low..high. Options left out "
        "take the scenario's own defaults.",
        texts("A,B,.."),
        without=("run",),
    )
