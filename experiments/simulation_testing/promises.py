"""Guarantees of the rules, and the guarantees that remain under false data.

A check applies only to rules that give the guarantee. It does not apply if a fault removes the
guarantee's conditions. Examples of these faults are a sensor that sends false readings and a
neighbour that sends false beliefs.
"""

from typing import Any

from concord.nodes.commands import Configure, Inject
from concord.scenarios.scenario import Scenario
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.assignment import flat
from concord.scenarios.types.rules import TrimmedCovarianceIntersection
from concord.topology.robustness import is_robust

# After these a reading says what its sensor never promised.
LYING_SENSORS = ("outlier", "bias", "stuck")

CERTAIN = ("ellipsoid", "zonotope")
CONSISTENT = ("ci", "sharp-ci", "wac", "hcmci", "labelled", "local", "centralised")
# Trimming loses information and adds none, though nobody has proved what it does to errors.
BOUNDED = (*CONSISTENT, "trimmed-ci")
GAUSSIAN = ("ci", "sharp-ci", "wac", "hcmci", "labelled", "trimmed-ci", "centralised")
RETURNING = (*GAUSSIAN, *CERTAIN)
# The filters know these plants as they are; that of meng2025 is approximated, and liu2021's noise
# is bounded and not Gaussian.
LINEAR = (
    "oscillator",
    "cruise-control",
    "suspension",
    "aircraft-pitch",
    "dc-motor-speed",
    "dc-motor-position",
)
MATCHED = (*LINEAR, "target-tracking", "target-crossing")


def promises(scenario: Scenario, rules: tuple[str, ...]) -> bool:
    """Whether only such rules are used in a run, and no share is taken for one of another step."""
    return all(
        settings.get("rule", rules[0]) in rules and settings.get("hold") != "raw"
        for settings in _used(scenario)
    )


def forgets_no_share(scenario: Scenario) -> bool:
    """Return whether the last share of a neighbour that falls silent has full weight for good."""
    return any(settings.get("hold") == "predict" for settings in _used(scenario))


def sensors_are_honest(scenario: Scenario) -> bool:
    """Return whether no change makes a sensor send a false reading."""
    return not any(fault.kind in LYING_SENSORS for fault in _faults(scenario))


def liars_of(scenario: Scenario) -> set[int]:
    """Return the nodes that send false beliefs at some time of a run."""
    return {
        fault.nodes[0] for fault in _faults(scenario) if fault.kind == "lie" and fault.numbers[0]
    }


def nodes_are_honest(scenario: Scenario) -> bool:
    """Return whether no node sends false data to its neighbours."""
    return not liars_of(scenario) or promises(scenario, ("local",))


def brings_back(setup: Setup) -> bool:
    """Return whether nodes recover as soon as a fault has ended.

    A lie that was believed is so only as fast as the plant forgets. The rule that expects liars
    brings nodes back where they agree with each other: on robust graphs that stay as they are.
    """
    scenario, neighbours, liars = setup.scenario, setup.neighbours, liars_of(setup.scenario)
    rule, expected = scenario.rule, 0
    if isinstance(rule, TrimmedCovarianceIntersection):
        expected = rule.liars
        agrees = is_robust(neighbours, 2 * expected + 1)
        if not agrees or scenario.network.links != "static":
            return False
    few = all(len(liars & {*heard}) <= expected for heard in neighbours)
    return not liars or (few and promises(scenario, ("trimmed-ci",)))


def _used(scenario: Scenario) -> list[dict[str, Any]]:
    """Return the settings of the beginning, and those of each change."""
    settings = (one.command for one in script_of(scenario))
    return [flat(scenario), *(one.settings for one in settings if isinstance(one, Configure))]


def _faults(scenario: Scenario) -> list[Inject]:
    return [one.command for one in script_of(scenario) if isinstance(one.command, Inject)]
