"""The left panel: run, network, node, link, view, export; each button says what came of it."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import msgspec
import viser

from dashboard.inputs import Inputs, at_once
from dashboard.source import Answer, Source
from dashboard.stage import Picture, Stage
from dashboard.theme import DARK, LIGHT
from dashboard.view import ELLIPSES, ORDERS, View
from nodes.commands import Refused, in_words
from scenarios.bus_plan import arbiter_names
from scenarios.rules import RULE_SUMMARIES

_RULES = tuple(RULE_SUMMARIES)
QUIET = (72, 80, 92)
"""Of buttons that are not the first thing to press."""
MAGNIFIED = (1, 2, 5, 10, 20, 50, 100)


class Controls:
    """The widgets of the left panel.

    `tell` says something to the person. Commands are asked of the source one after the other, in a
    thread of their own. For a recording there is no network to command, and those widgets are not
    made.
    """

    def __init__(
        self, gui: viser.GuiApi, inputs: Inputs, source: Source, view: View,
        tell: Callable[[Any, str, str, bool], None],
    ) -> None:  # fmt: skip
        self._gui, self._inputs, self._stage = gui, inputs, source.stage
        self._source, self._tell, self._live = source, tell, source.live
        self._commands = ThreadPoolExecutor(1, "commands")
        self._newest: dict[str, dict[str, Any]] = {}
        self._shown_node = 0
        self.status: Any = gui.add_html("")
        self._run_folder()
        if source.live:
            self._network_folder()
            self._node_folder()
        self._view_folder(view)

    # --- the run ------------------------------------------------------------------------------

    def _run_folder(self) -> None:
        gui = self._gui
        with gui.add_folder("Run"):
            self.pause: Any = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
            self.one: Any = gui.add_button("Step", color=QUIET, icon=viser.Icon.PLAYER_TRACK_NEXT)
            top = 100 if self._live else 16
            self.speed: Any = gui.add_slider(
                "Steps/s" if self._live else "Speed", 0, top, 1 if self._live else 0.25,
                0 if self._live else 1.0,
                hint="0 is as fast as possible" if self._live else "1 is as fast as the plant",
            )  # fmt: skip
            self.go_live: Any = gui.add_button(
                "Go live" if self._live else "Go to the end", color=QUIET, icon=viser.Icon.BROADCAST
            )
        self.pause.on_click(at_once(lambda event: self.toggle(event.client)))
        self.one.on_click(at_once(lambda event: self.step_once(event.client)))
        self.speed.on_update(at_once(self._set_speed))
        self.go_live.on_click(at_once(lambda _: self.follow()))

    def toggle(self, client: Any) -> None:
        """Pause what runs, resume what is paused."""
        if self._live:
            self._soon(self._toggle_network, client)
        else:
            self._inputs.alter(lambda view: setattr(view, "playing", not view.playing))

    def _toggle_network(self, client: Any) -> None:
        self._command({"do": "resume" if self._is_paused() else "pause"}, client)

    def _is_paused(self) -> bool:
        return self._source.pace().state == "PAUSED"

    def step_once(self, client: Any) -> None:
        """One step more; a network that runs is paused first."""
        if self._live:
            self._soon(self._step_network, client)
        else:
            self._inputs.alter(lambda view: view.look_at(view.step + 1))

    def _step_network(self, client: Any) -> None:
        if self._is_paused() or self._command({"do": "pause"}, client).accepted:
            self._command({"do": "step", "count": 1}, client)
            self.follow()

    def follow(self) -> None:
        """Show the newest step, and what comes."""
        self._inputs.alter(lambda view: setattr(view, "follow", True))

    def _set_speed(self, event: Any) -> None:
        rate = float(self.speed.value)
        if self._live:
            command = {"do": "speed", "steps_per_second": rate}
            self._newest_only("speed", command, event.client)
        else:
            self._inputs.alter(lambda view: setattr(view, "speed", rate))

    def _soon(self, act: Callable[..., object], *values: Any) -> None:
        self._commands.submit(act, *values).add_done_callback(_raise)

    def _newest_only(self, what: str, command: dict[str, Any], client: Any) -> None:
        """Of what a slider passes on its way, the network is asked for the last."""
        self._newest[what] = command

        def ask() -> None:
            if newest := self._newest.pop(what, None):
                self._command(newest, client)

        self._soon(ask)

    def close(self) -> None:
        """Ask for nothing more."""
        self._commands.shutdown(wait=False, cancel_futures=True)

    def _command(self, command: dict[str, Any], client: Any) -> Answer:
        answer = self._source.ask(command)
        what = " ".join(str(value) for value in command.values())
        if not answer.accepted:
            self._tell(client, "Refused", answer.detail or what, True)
        elif command["do"] not in ("pause", "resume", "step", "speed"):
            self._tell(client, "Accepted", what, False)
        return answer

    def show_paused(self, paused: bool) -> None:
        """What the button says."""
        self.pause.label = "Resume" if paused else "Pause"
        self.pause.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE

    # --- the network --------------------------------------------------------------------------

    def _network_folder(self) -> None:
        gui, scenario = self._gui, self._stage.setup.scenario
        with gui.add_folder("Network"):
            self.rounds: Any = gui.add_number("Rounds", scenario.rounds, min=1, max=20, step=1)
            rules = _RULES if scenario.rule in _RULES else (scenario.rule, *_RULES)
            self.rule: Any = gui.add_dropdown("Rule", rules, initial_value=scenario.rule)
            self.occupancy: Any = gui.add_slider(
                "Occupancy", 0.05, 1.0, 0.05, _on_slider(scenario.occupancy)
            )
            self.arbiter: Any = gui.add_dropdown(
                "Arbiter", arbiter_names(), initial_value=scenario.arbiter
            )
            self.apply: Any = gui.add_button("Apply at the next step", icon=viser.Icon.CHECK)
        self.apply.on_click(at_once(self._apply))

    def _apply(self, event: Any) -> None:
        scenario = self._stage.setup.scenario
        wanted = {
            "rounds": int(self.rounds.value), "rule": self.rule.value,
            "occupancy": float(self.occupancy.value), "arbiter": self.arbiter.value,
        }  # fmt: skip
        there = {name: getattr(scenario, name) for name in wanted}
        there["occupancy"] = _on_slider(scenario.occupancy)
        changed = {name: value for name, value in wanted.items() if there[name] != value}
        # A full schedule has no room for less; half of the slots static is the house's default.
        if changed.get("occupancy", 1.0) < 1.0 and scenario.schedule == "full":
            changed["schedule"] = "hybrid"
        if not changed:
            self._tell(event.client, "Nothing to apply", "the network has these settings", False)
            return
        self._soon(self._command, {"do": "set", "settings": changed}, event.client)

    def set_stage(self, stage: Stage) -> None:
        """The settings as the network has them now."""
        self._stage = stage
        if self._live:
            scenario = stage.setup.scenario
            self._inputs.show(self.rounds, value=scenario.rounds)
            self._inputs.show(self.arbiter, value=scenario.arbiter)
            self._inputs.show(self.occupancy, value=_on_slider(scenario.occupancy))
            if scenario.rule in self.rule.options:
                self._inputs.show(self.rule, value=scenario.rule)

    # --- nodes and links ----------------------------------------------------------------------

    def _node_folder(self) -> None:
        gui, names = self._gui, self._stage.names
        with gui.add_folder("Node and link"):
            self.node: Any = gui.add_dropdown("Node", names, initial_value=names[0])
            self.life: Any = gui.add_button_group("Node is", ("kill", "restart"))
            self.peer: Any = gui.add_dropdown(
                "Link to", self._peers(0), initial_value=self._peers(0)[0]
            )
            self.link: Any = gui.add_button_group("Link", ("cut", "heal"))
            self.loss: Any = gui.add_slider("Loss", 0.0, 0.95, 0.05, 0.0)
            self.fault: Any = gui.add_text(
                "Fault", "", hint="in words: corrupt 0.05 1 2, hang 3 5, lie 3 5 4, heal, calm, ..."
            )
            self.inject: Any = gui.add_button("Inject", color=QUIET, icon=viser.Icon.BOLT)
        self.node.on_update(at_once(self._choose_node))
        self.life.on_click(at_once(self._kill_or_restart))
        self.link.on_click(at_once(self._cut_or_heal))
        self.loss.on_update(at_once(self._set_loss))
        self.inject.on_click(at_once(self._inject))

    def _peers(self, node: int) -> tuple[str, ...]:
        edges = self._stage.edges[(self._stage.edges == node).any(axis=1)]
        peers = sorted({int(i) for edge in edges for i in edge if i != node})
        return tuple(self._stage.names[i] for i in peers) or ("-",)

    def show_selected(self, node: int | None) -> None:
        """The dropdowns follow the selection, when that changes."""
        if not self._live or node is None or self._shown_node == node:
            return
        self._shown_node = node
        self._inputs.show(self.node, value=self._stage.names[node])
        self._inputs.show(self.peer, options=self._peers(node))

    def _choose_node(self, event: Any) -> None:
        node = self._stage.names.index(self.node.value)
        self.peer.options = self._peers(node)
        self._inputs.alter(lambda view: setattr(view, "selected", node))

    def _kill_or_restart(self, event: Any) -> None:
        node = self._stage.names.index(self.node.value)
        self._soon(self._command, {"do": self.life.value, "node": node}, event.client)

    def _link(self) -> dict[str, int]:
        names = self._stage.names
        return {
            "sender": names.index(self.node.value), "receiver": names.index(self.peer.value),
        }  # fmt: skip

    def _cut_or_heal(self, event: Any) -> None:
        if self.peer.value in self._stage.names:
            self._soon(self._command, {"do": self.link.value, **self._link()}, event.client)

    def _set_loss(self, event: Any) -> None:
        if self.peer.value in self._stage.names:
            command = {"do": "loss", "probability": float(self.loss.value), **self._link()}
            what = f"loss {command['sender']} {command['receiver']}"
            self._newest_only(what, command, event.client)

    def _inject(self, event: Any) -> None:
        try:
            command = in_words(self.fault.value.split())
        except Refused as refused:
            self._tell(event.client, "Refused", str(refused), True)
            return
        self._soon(self._command, msgspec.to_builtins(command), event.client)

    # --- the view -----------------------------------------------------------------------------

    def _view_folder(self, view: View) -> None:
        gui, stage = self._gui, self._stage
        with gui.add_folder("View"):
            self.dark: Any = gui.add_checkbox("Dark", view.theme.dark)
            if stage.picture is Picture.PLANE:
                ellipses: Any = gui.add_dropdown("Ellipses", ELLIPSES, initial_value=view.ellipses)
                self.magnify: Any = gui.add_dropdown(
                    "Errors ×", tuple(map(str, MAGNIFIED)), initial_value=f"{view.magnify:g}",
                    hint="how much larger than the map errors and ellipses are drawn",
                )  # fmt: skip
                sights: Any = gui.add_checkbox("Sight lines", view.sight_lines)
                self._bind(ellipses, "ellipses", str)
                self._bind(self.magnify, "magnify", float)
                self._bind(sights, "sight_lines", bool)
                if stage.sight_range_m is not None:
                    reach: Any = gui.add_checkbox("Sensing range", view.sight_range)
                    self._bind(reach, "sight_range", bool)
            labels: Any = gui.add_checkbox("Names", view.labels)
            order: Any = gui.add_dropdown("Table by", ORDERS, initial_value=view.order)
            states = stage.state_names
            across: Any = gui.add_dropdown("Beliefs →", states, initial_value=states[view.pair[0]])
            up: Any = gui.add_dropdown("Beliefs ↑", states, initial_value=states[view.pair[1]])
            state: Any = gui.add_dropdown("State chart", states, initial_value=states[view.state])
        self._bind(labels, "labels", bool)
        self._bind(order, "order", str)
        self._bind(across, "pair", lambda _: self._pair(across, up))
        self._bind(up, "pair", lambda _: self._pair(across, up))
        self._bind(state, "state", states.index)
        self._bind(self.dark, "theme", lambda dark: DARK if dark else LIGHT)

    def _pair(self, across: Any, up: Any) -> tuple[int, int]:
        states = self._stage.state_names
        return states.index(across.value), states.index(up.value)

    def _bind(self, widget: Any, name: str, meaning: Callable[[Any], Any]) -> None:
        def take(_: Any) -> None:
            value = meaning(widget.value)
            self._inputs.alter(lambda view: setattr(view, name, value))

        widget.on_update(at_once(take))


def _on_slider(occupancy: float) -> float:
    """The place of the slider that is nearest to an occupancy."""
    return max(1, round(occupancy * 20)) / 20


def _raise(done: "Future[object]") -> None:
    """What went wrong in a thread that nobody waits for is said, not lost."""
    if not done.cancelled():
        done.result()
