"""concord: sensor networks that agree on what they observe, simulated message by message.

    import concord as cc

    scenario = cc.scenario("target-tracking", nodes=20, graph="geometric")
    runs = cc.simulate(scenario.with_(rule="hcmci"), runs=50)

docs/python_api.md explains each name. A name is loaded when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from concord._version import __version__ as __version__

if TYPE_CHECKING:
    from concord import filters as filters
    from concord import topology as topology
    from concord.experiments.python_api import agree as agree
    from concord.experiments.python_api import compare as compare
    from concord.experiments.python_api import design as design
    from concord.experiments.python_api import launch as launch
    from concord.experiments.python_api import load as load
    from concord.experiments.python_api import plots as plots
    from concord.experiments.python_api import scenario as scenario
    from concord.experiments.python_api import simulate as simulate
    from concord.experiments.python_api import sweep as sweep
    from concord.features.flexray_tools import api as flexray
    from concord.features.measurement_bus.own_measured import (
        on_a_measurement_bus as on_a_measurement_bus,
    )
    from concord.features.sets.bounded_plant import BoundedOutput as BoundedOutput
    from concord.features.sets.bounded_plant import BoundedPlant as BoundedPlant
    from concord.plants.own_plant import OwnPlant as OwnPlant
    from concord.plants.own_plant import OwnSensor as OwnSensor
    from concord.plants.own_plant import from_control as from_control
    from concord.scenarios.definitions.own import own_scenario as own_scenario
    from concord.scenarios.scenario import Scenario as Scenario
    from concord.scenarios.types import buses as buses
    from concord.scenarios.types import holds as holds
    from concord.scenarios.types import rules as rules
    from concord.scenarios.types.filters import ConstrainedReceiver as ConstrainedReceiver
    from concord.scenarios.types.filters import EllipsoidReceiver as EllipsoidReceiver
    from concord.scenarios.types.filters import ZonotopeReceiver as ZonotopeReceiver

_API = "concord.experiments.python_api"
_OWN = "concord.plants.own_plant"
_TYPES = "concord.scenarios.types"
# The module of each public name, or the package of a public module.
_HOMES = {
    **dict.fromkeys(("agree", "compare", "design", "launch", "load", "plots"), _API),
    **dict.fromkeys(("scenario", "simulate", "sweep"), _API),
    **dict.fromkeys(("OwnPlant", "OwnSensor", "from_control"), _OWN),
    **dict.fromkeys(("BoundedPlant", "BoundedOutput"), "concord.features.sets.bounded_plant"),
    **dict.fromkeys(
        ("ConstrainedReceiver", "EllipsoidReceiver", "ZonotopeReceiver"), f"{_TYPES}.filters"
    ),
    "on_a_measurement_bus": "concord.features.measurement_bus.own_measured",
    "own_scenario": "concord.scenarios.definitions.own",
    "Scenario": "concord.scenarios.scenario",
    **dict.fromkeys(("buses", "holds", "rules"), _TYPES),
    **dict.fromkeys(("filters", "flexray", "topology"), "concord"),
}


if not TYPE_CHECKING:  # A checker would believe that concord has every name.

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"concord has no {name!r}; it has {', '.join(sorted(_HOMES))}")
        home = _HOMES[name]
        if home == "concord":
            return import_module(f"concord.{name}")
        module = import_module(home)
        return getattr(module, name) if hasattr(module, name) else import_module(f"{home}.{name}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
