"""Guarantees of the rules, and the guarantees that remain under false data.

A check applies only to rules that give the guarantee. It does not apply if a fault removes the
guarantee's conditions. Examples of these faults are a sensor that sends false readings and a
neighbour that sends false beliefs.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from concord.nodes.commands import Configure, Inject
from concord.scenarios.rule_table.rules import Rule, rule_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.assignment import flat
from concord.scenarios.types.rules import TrimmedCovarianceIntersection
from concord.studies.check.drawn_networks import EXACT_PLANTS
from concord.topology.analysis import is_robust

# After these a reading says what its sensor never promised.
LYING_SENSORS = ("outlier", "bias", "stuck")

# The filters know these plants as they are, or approximate them well; that of meng2025 is
# approximated, and liu2021's noise is bounded and not Gaussian.
MATCHED = (*EXACT_PLANTS, "target-tracking", "target-crossing")


class Claim(NamedTuple):
    """A guarantee, and whether a rule of this name gives it."""

    holds: Callable[[str, Rule], bool]


CERTAIN = Claim(lambda name, rule: rule.set_valued)
CONSISTENT = Claim(lambda name, rule: rule.consistent and not rule.set_valued)
# Trimming loses information and adds none; no proof says how it changes errors.
BOUNDED = Claim(lambda name, rule: name == "trimmed-ci" or CONSISTENT.holds(name, rule))
GAUSSIAN = Claim(lambda name, rule: name != "local" and BOUNDED.holds(name, rule))
RETURNING = Claim(lambda name, rule: rule.set_valued or GAUSSIAN.holds(name, rule))
_ALONE = Claim(lambda name, rule: name == "local")
_TRIMMED = Claim(lambda name, rule: name == "trimmed-ci")


def promises(scenario: Scenario, claim: Claim) -> bool:
    """Return whether all rules of a run give a guarantee, with a hold policy that ages shares."""
    used = _used(scenario)
    names = {settings["rule"] for settings in used if "rule" in settings}
    rules = {name: rule_of(scenario.with_known(rule=name)[0]) for name in names}
    return all(claim.holds(*one) for one in rules.items()) and not any(
        settings.get("hold") == "raw" for settings in used
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
    return not liars_of(scenario) or promises(scenario, _ALONE)


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
    return not liars or (few and promises(scenario, _TRIMMED))


def _used(scenario: Scenario) -> list[dict[str, Any]]:
    """Return the settings of the beginning, and those of each change."""
    settings = (one.command for one in script_of(scenario))
    return [flat(scenario), *(one.settings for one in settings if isinstance(one, Configure))]


def _faults(scenario: Scenario) -> list[Inject]:
    return [one.command for one in script_of(scenario) if isinstance(one.command, Inject)]
