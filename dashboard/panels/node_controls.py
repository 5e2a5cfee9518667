"""Widgets for faults of a live network: nodes that die, links that fail, faults in words."""

from typing import Any

import msgspec
import viser

from concord.dashboard.frames.stage import Stage
from concord.dashboard.inputs import Inputs, at_once
from concord.dashboard.panels.commands import Commands
from concord.dashboard.theme import QUIET_BUTTON
from concord.nodes.commands import Refused, in_words


class NodeControls:
    """The folder of one node and one of its links."""

    def __init__(self, gui: viser.GuiApi, inputs: Inputs, commands: Commands, stage: Stage) -> None:
        self._inputs, self._commands, self._stage = inputs, commands, stage
        self._shown_node = 0
        names = stage.names
        with gui.add_folder("Node and link", expand_by_default=False):
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
            self.inject: Any = gui.add_button("Inject", color=QUIET_BUTTON, icon=viser.Icon.BOLT)
        self.node.on_update(at_once(self._choose_node))
        self.life.on_click(at_once(self._kill_or_restart))
        self.link.on_click(at_once(self._cut_or_heal))
        self.loss.on_update(at_once(self._set_loss))
        self.inject.on_click(at_once(self._inject))

    @property
    def widgets(self) -> list[Any]:
        """Return the widgets that command the network; `groups` has the groups of buttons."""
        return [self.peer, self.loss, self.fault, self.inject]

    @property
    def groups(self) -> list[Any]:
        """Return the groups of buttons that command the network."""
        return [self.life, self.link]

    def _peers(self, node: int) -> tuple[str, ...]:
        edges = self._stage.edges[(self._stage.edges == node).any(axis=1)]
        peers = sorted({int(i) for edge in edges for i in edge if i != node})
        return tuple(self._stage.names[i] for i in peers) or ("-",)

    def set_stage(self, stage: Stage) -> None:
        """Offer the links that the network has now."""
        self._stage = stage
        self._inputs.show(self.peer, options=self._peers(stage.names.index(self.node.value)))

    def show_selected(self, node: int | None) -> None:
        """Let the dropdowns follow the selection when it changes."""
        if node is None or self._shown_node == node:
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
        self._commands.soon(
            self._commands.send, {"do": self.life.value, "node": node}, event.client
        )

    def _link(self) -> dict[str, int]:
        names = self._stage.names
        return {
            "sender": names.index(self.node.value), "receiver": names.index(self.peer.value),
        }  # fmt: skip

    def _cut_or_heal(self, event: Any) -> None:
        if self.peer.value in self._stage.names:
            self._commands.soon(
                self._commands.send, {"do": self.link.value, **self._link()}, event.client
            )

    def _set_loss(self, event: Any) -> None:
        if self.peer.value in self._stage.names:
            command = {"do": "loss", "probability": float(self.loss.value), **self._link()}
            what = f"loss {command['sender']} {command['receiver']}"
            self._commands.newest_only(what, command, event.client)

    def _inject(self, event: Any) -> None:
        try:
            command = in_words(self.fault.value.split())
        except Refused as refused:
            self._commands.tell(event.client, "Refused", str(refused), True)
            return
        self._commands.soon(self._commands.send, msgspec.to_builtins(command), event.client)
