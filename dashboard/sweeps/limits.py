"""Widgets that limit the cells of a sweep to some values of each field."""

from collections.abc import Callable
from typing import Any

import viser

from concord.dashboard.inputs import at_once
from concord.dashboard.sweeps.swept import FieldValue, SweptCells, is_number, worded

Limit = Callable[[str, tuple[FieldValue, ...]], None]
"""(field, values): show only cells with these values of the field."""
_ALL = "all"
# A field of more values is limited by a slider.
_MOST_CHOICES = 12


def limit_widgets(gui: viser.GuiApi, swept: SweptCells, limit: Limit) -> None:
    """Add a widget for each field, which calls `limit` in viser's event loop."""
    if not swept.fields:
        return
    with gui.add_folder("Show"):
        for field in swept.fields:
            levels = swept.levels(field)
            if len(levels) > _MOST_CHOICES and all(map(is_number, levels)):
                _slider(gui, field, levels, limit)
            else:
                _dropdown(gui, field, levels, limit)


def _dropdown(gui: viser.GuiApi, field: str, levels: list[FieldValue], limit: Limit) -> None:
    by_word = {worded(level): level for level in levels}
    chosen: Any = gui.add_dropdown(field, (_ALL, *by_word))

    def take(_: Any) -> None:
        one = chosen.value
        limit(field, tuple(levels) if one == _ALL else (by_word[one],))

    chosen.on_update(at_once(take))


def _slider(gui: viser.GuiApi, field: str, levels: list[Any], limit: Limit) -> None:
    ends = float(levels[0]), float(levels[-1])
    step = (ends[1] - ends[0]) / 100
    between: Any = gui.add_multi_slider(field, *ends, step, initial_value=ends)

    def take(_: Any) -> None:
        low, high = between.value
        limit(field, tuple(one for one in levels if low - step / 2 <= one <= high + step / 2))

    between.on_update(at_once(take))
