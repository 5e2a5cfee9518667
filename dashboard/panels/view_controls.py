"""Widgets for what the page shows: theme, ellipses, labels, order, chosen states."""

from collections.abc import Callable
from typing import Any

import viser

from concord.dashboard.frames.stage import PlantDrawing, Stage
from concord.dashboard.inputs import Inputs, at_once
from concord.dashboard.scene.magnification import MAGNIFIED
from concord.dashboard.theme import DARK, LIGHT, QUIET_BUTTON
from concord.dashboard.view import ELLIPSES, ORDERS, WINDOWS_S, View

_AUTOMATIC = "auto"


class ViewControls:
    """The folder of the view."""

    def __init__(
        self,
        gui: viser.GuiApi,
        inputs: Inputs,
        stage: Stage,
        view: View,
        fit: Callable[[viser.ClientHandle], None],
    ) -> None:
        self._inputs, self._stage = inputs, stage
        with gui.add_folder("View", expand_by_default=False):
            button: Any = gui.add_button("Fit", color=QUIET_BUTTON, icon=viser.Icon.MAXIMIZE)
            button.on_click(at_once(lambda event: fit(event.client)))
            self.dark: Any = gui.add_checkbox("Dark", view.theme.dark)
            if stage.picture is PlantDrawing.PLANE:
                ellipses: Any = gui.add_dropdown("Ellipses", ELLIPSES, initial_value=view.ellipses)
                self.magnify: Any = gui.add_dropdown(
                    "Errors ×", (_AUTOMATIC, *map(str, MAGNIFIED)), initial_value=_AUTOMATIC,
                    hint="how much larger than the map errors and ellipses are drawn; the scene "
                    "names the factor",
                )  # fmt: skip
                self.target: Any = gui.add_checkbox(
                    "Follow target", view.follow_target, hint="the camera moves with the target"
                )
                self._bind(self.target, "follow_target", bool)
                sights: Any = gui.add_checkbox("Sight lines", view.sight_lines)
                self._bind(ellipses, "ellipses", str)
                self.magnify.on_update(at_once(lambda _: self._magnify()))
                self._bind(sights, "sight_lines", bool)
                if stage.sight_range_m is not None:
                    reach: Any = gui.add_checkbox("Sensing range", view.sight_range)
                    self._bind(reach, "sight_range", bool)
            labels: Any = gui.add_checkbox("Names", view.labels)
            order: Any = gui.add_dropdown("Table by", ORDERS, initial_value=view.order)
            window: Any = gui.add_dropdown("Charts of", tuple(WINDOWS_S))
            states = stage.state_names
            across: Any = gui.add_dropdown("Beliefs →", states, initial_value=states[view.pair[0]])
            up: Any = gui.add_dropdown("Beliefs ↑", states, initial_value=states[view.pair[1]])
            state: Any = gui.add_dropdown("State chart", states, initial_value=states[view.state])
        self._bind(labels, "labels", bool)
        self._bind(order, "order", str)
        self._bind(window, "window_s", WINDOWS_S.__getitem__)
        self._bind(across, "pair", lambda _: self._pair(across, up))
        self._bind(up, "pair", lambda _: self._pair(across, up))
        self._bind(state, "state", states.index)
        self._bind(self.dark, "theme", lambda dark: DARK if dark else LIGHT)

    def _magnify(self) -> None:
        chosen = self.magnify.value

        def take(view: View) -> None:
            view.is_automatic = chosen == _AUTOMATIC
            view.magnify = view.magnify if view.is_automatic else float(chosen)

        self._inputs.alter(take)

    def _pair(self, across: Any, up: Any) -> tuple[int, int]:
        states = self._stage.state_names
        return states.index(across.value), states.index(up.value)

    def _bind(self, widget: Any, name: str, meaning: Callable[[Any], Any]) -> None:
        def take(_: Any) -> None:
            value = meaning(widget.value)
            self._inputs.alter(lambda view: setattr(view, name, value))

        widget.on_update(at_once(take))
