"""concord: sensor networks that agree on what they observe, simulated message by message.

    import concord as cc

    scenario = cc.scenario("target-tracking", nodes=20, graph="geometric")
    runs = cc.simulate(scenario.with_(rule="hcmci"), runs=50)

docs/python_api.md explains each name. A name is loaded when it is first used. Features and
packages add names by their entries (`concord.entries`).
"""

from typing import TYPE_CHECKING, Any

from concord._version import __version__ as __version__

if TYPE_CHECKING:
    from concord import filters as filters
    from concord import topology as topology
    from concord.experiments.python_api import agree as agree
    from concord.experiments.python_api import figures as figures
    from concord.experiments.python_api import launch as launch
    from concord.experiments.python_api import load as load
    from concord.experiments.python_api import scenario as scenario
    from concord.experiments.python_api import simulate as simulate
    from concord.experiments.python_studies import compare as compare
    from concord.experiments.python_studies import design as design
    from concord.experiments.python_studies import exact as exact
    from concord.experiments.python_studies import identify as identify
    from concord.experiments.python_studies import plots as plots
    from concord.experiments.python_studies import sweep as sweep
    from concord.plants.linear_systems import from_control as from_control
    from concord.plants.own_plant import OwnPlant as OwnPlant
    from concord.plants.own_sensor import OwnSensor as OwnSensor
    from concord.plants.own_sensor import TrueSensor as TrueSensor
    from concord.plants.own_truth import TruePlant as Truth  # noqa: F401
    from concord.scenarios.definitions.own import own_scenario as own_scenario
    from concord.scenarios.scenario import Scenario as Scenario
    from concord.scenarios.types import buses as buses
    from concord.scenarios.types import holds as holds
    from concord.scenarios.types import rules as rules
    from concord.scenarios.types import schedules as schedules


if not TYPE_CHECKING:  # A checker would believe that concord has every name.

    def __getattr__(name: str) -> Any:
        from concord.entries import chosen, entries

        known = entries("NAMES")
        if name not in known:
            raise AttributeError(f"concord has no {name!r}; it has {', '.join(sorted(known))}")
        return chosen("NAMES", name)


def __dir__() -> list[str]:
    from concord.entries import entries

    return sorted({*globals(), *entries("NAMES")})
