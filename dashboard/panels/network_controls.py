"""Widgets for the settings of a network: rounds, rule, occupancy, arbiter."""

from typing import Any

import viser

from concord.dashboard.frames.stage import Stage
from concord.dashboard.inputs import Inputs, at_once
from concord.dashboard.panels.commands import Commands
from concord.entries import summaries
from concord.scenarios.bus_table.bus_plan import arbiter_names
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.schedules import arbiter_of, occupancy_of

_RULES = tuple(summaries("RULES"))


class NetworkControls:
    """The folder of a live network's settings."""

    def __init__(self, gui: viser.GuiApi, inputs: Inputs, commands: Commands, stage: Stage) -> None:
        self._inputs, self._commands, self._stage = inputs, commands, stage
        scenario = stage.setup.scenario
        with gui.add_folder("Network", expand_by_default=False):
            self.rounds: Any = gui.add_number("Rounds", scenario.rounds, min=1, max=20, step=1)
            now = _settings_of(scenario)
            self.rule: Any = gui.add_dropdown(
                "Rule", rules_beside(now["rule"]), initial_value=now["rule"]
            )
            self.occupancy: Any = gui.add_slider("Occupancy", 0.05, 1.0, 0.05, now["occupancy"])
            self.arbiter: Any = gui.add_dropdown(
                "Arbiter", arbiter_names(), initial_value=now["arbiter"]
            )
            self.apply: Any = gui.add_button("Apply at the next step", icon=viser.Icon.CHECK)
        self.apply.on_click(at_once(self._apply))

    @property
    def widgets(self) -> list[Any]:
        """Return the widgets that command the network."""
        return [self.rounds, self.rule, self.occupancy, self.arbiter, self.apply]

    def _apply(self, event: Any) -> None:
        scenario = self._stage.setup.scenario
        wanted = {
            "rounds": int(self.rounds.value), "rule": self.rule.value,
            "occupancy": float(self.occupancy.value), "arbiter": self.arbiter.value,
        }  # fmt: skip
        there = _settings_of(scenario)
        changed = {name: value for name, value in wanted.items() if there[name] != value}
        # A full schedule has no room for less.
        if changed.get("occupancy", 1.0) < 1.0 and scenario.bus.schedule.name == "full":
            changed["schedule"] = scenario.bus.partial_schedule
        if not changed:
            self._commands.tell(
                event.client, "Nothing to apply", "the network has these settings", False
            )
            return
        self._commands.soon(self._commands.send, {"do": "set", "settings": changed}, event.client)

    def set_stage(self, stage: Stage) -> None:
        """Show the settings that the network has now."""
        self._stage = stage
        self.rule.options = rules_beside(stage.setup.scenario.rule.name)
        for name, value in _settings_of(stage.setup.scenario).items():
            self._inputs.show(getattr(self, name), value=value)


def rules_beside(name: str) -> tuple[str, ...]:
    """The rules to choose from: those of concord, and the one of that name, of a user's file."""
    return tuple(dict.fromkeys((*_RULES, name)))


def _settings_of(scenario: Scenario) -> dict[str, Any]:
    """Return the settings of a scenario as the widgets show them."""
    schedule = scenario.bus.schedule
    return {
        "rounds": scenario.rounds,
        "rule": scenario.rule.name,
        "occupancy": max(1, round(occupancy_of(schedule) * 20)) / 20,
        "arbiter": arbiter_of(schedule),
    }
