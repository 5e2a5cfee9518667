"""Fusion rules and hold policies by name, as the values that a node is built from."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from filters import hold
from filters.fusion import INFORMATION, MOMENTS
from filters.gaussian import Gaussian
from filters.hybrid_consensus import classical_gain, safe_gain
from filters.local import keep_own
from filters.packed import packed_length
from nodes.belief_consensus import HoldPolicy
from nodes.estimator import Estimator
from nodes.messages import Array
from nodes.set_shapes import Ellipsoids, Zonotopes
from nodes.vectorised_network import Fleet
from scenarios import set_rules
from scenarios.estimators import (
    Seat,
    averaging,
    averaging_numbers,
    diffused,
    flooding,
    hybrid,
    pulled,
    trimmed,
    weighted_information,
)
from scenarios.fleets import (
    FleetSeat,
    averaging_fleet,
    diffused_fleet,
    flooding_fleet,
    hybrid_fleet,
    local_fleet,
    pulled_fleet,
    weighted_information_fleet,
)
from scenarios.labelled import (
    LABELLED_FIELDS,
    check_labelled,
    largest_share,
    without_arrays,
)
from scenarios.scenario import Scenario, lossy_links
from topology.names import unknown_name

if TYPE_CHECKING:
    from scenarios.setup import Setup
    from topology.weights import Weights

_NUMBERS = {"float64": "<f8", "float32": "<f4"}
_DEFAULT_HOLD = "decayed"


class Rule(NamedTuple):
    """A fusion rule of the network.

    Attributes:
        summary: what it promises, one line for `concord list`.
        share_numbers: how many numbers are in a share, for so many states and nodes; None for
            shares of any length up to `scenario.payload_bytes`.
        estimator: builds that of one node.
        holds: whether shares of silent neighbours are held, as --hold says.
        relays: whether a node can send on what it has heard in the same cycle.
        check: refuses scenario, neighbours of each node and weights (N, N) that it cannot do with.
        certain: covariances are shape matrices of ellipsoids that hold the truth for certain.
        listen: (setup, nodes, readings (steps, N, r, d), control (steps, p) or None) -> beliefs
            (steps,) of one filter that takes the readings of these nodes; None for the Gaussian
            filter of the scenario.
        fleet: builds the rule at all nodes of many runs; None for a rule without an array form.
        lacking: what of a scenario the array form does not have; None if it has all.
        shares_beliefs: a share is a mean and a covariance.
        own: fields of `Scenario` that mean something here and not under every rule.
        ignores: fields that mean something under other rules and nothing here.
    """

    summary: str
    share_numbers: Callable[[int, int], int] | None
    estimator: Callable[[Seat], Estimator]
    holds: bool = False
    relays: bool = False
    check: "Callable[[Scenario, Sequence[Sequence[int]], Weights], None] | None" = None
    certain: bool = False
    listen: "Callable[[Setup, Sequence[int], Array, Array | None], Gaussian] | None" = None
    fleet: Callable[[FleetSeat], Fleet] | None = None
    lacking: Callable[[Scenario], str | None] = lambda _: None
    shares_beliefs: bool = False
    own: tuple[str, ...] = ()
    ignores: tuple[str, ...] = ()


def rules_where(holds: Callable[[Rule], bool]) -> tuple[str, ...]:
    """The names of the rules of which that holds."""
    return tuple(name for name, rule in _RULES.items() if holds(rule))


def rules_by_own_field() -> dict[str, tuple[str, ...]]:
    """For each field that means something under some rules alone, the names of those."""
    fields = {field: None for rule in _RULES.values() for field in rule.own}
    return {field: rules_where(lambda rule, own=field: own in rule.own) for field in fields}


def rule_of(scenario: Scenario) -> Rule:
    """The scenario's rule.

    Raises:
        ValueError: there is no such rule.
    """
    if scenario.rule not in _RULES:
        raise unknown_name("rule", scenario.rule, _RULES)
    return _RULES[scenario.rule]


def is_certain(scenario: Scenario) -> bool:
    """Whether its estimates are sets that hold the truth for certain."""
    rule = _RULES.get(scenario.rule)
    return rule is not None and rule.certain


def check_rule(scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights") -> None:
    """Refuse a rule on a network that it cannot run on, or with a hold policy that it cannot use.

    Raises:
        ValueError: naming the rule, what is in its way, and the cure.
    """
    rule = rule_of(scenario)
    hold_policy(scenario)
    # The default of a scenario is that of the rules that hold, and nobody's wish for the others.
    if not rule.holds and scenario.hold not in (_DEFAULT_HOLD, "renormalise"):
        raise ValueError(
            f"--hold {scenario.hold}: rule {scenario.rule} fuses fresh shares alone and holds "
            "none; leave --hold out, or choose rule ci or wac"
        )
    if scenario.relay and not rule.relays:
        raise ValueError(
            f"--relay with rule {scenario.rule}: averaging what was averaged in the same cycle "
            "gives other weights than the network's; leave --relay out, or choose rule labelled"
        )
    if rule.check is not None:
        rule.check(scenario, neighbours, weights)


def build_estimator(scenario: Scenario, seat: Seat) -> Estimator:
    """The estimator at one node.

    Raises:
        ValueError: there is no such rule.
    """
    return rule_of(scenario).estimator(seat)


def share_size(scenario: Scenario, states: int) -> int:
    """Length in bytes of the longest share in a network whose plant has so many states."""
    share_numbers = rule_of(scenario).share_numbers
    if share_numbers is None:
        return largest_share(scenario, states)
    numbers = share_numbers(states, scenario.nodes)
    return numbers * np.dtype(wire_number(scenario)).itemsize


def hold_policy(scenario: Scenario) -> HoldPolicy:
    """The scenario's hold policy; `renormalise` for a rule that holds nothing.

    Raises:
        ValueError: there is no such policy or rule.
    """
    if scenario.hold not in _HOLDS:
        raise unknown_name("hold", scenario.hold, _HOLDS)
    return _HOLDS[scenario.hold if rule_of(scenario).holds else "renormalise"](scenario)


def hold_names() -> tuple[str, ...]:
    """The hold policies there are."""
    return tuple(_HOLDS)


def wire_number(scenario: Scenario) -> str:
    """The numpy type code of numbers in a share."""
    return _NUMBERS[scenario.number]


# --- hold policies -------------------------------------------------------------------------------


def _decayed(
    decay: float,
    base_weights: np.ndarray,
    ages: np.ndarray,
    sharpness: np.ndarray,
    _cycles_in_step: int,
) -> np.ndarray:
    return hold.held_weights(base_weights, ages, decay, sharpness)


def _by_age(
    weigh: Callable[[np.ndarray, np.ndarray], np.ndarray],
    base_weights: np.ndarray,
    ages: np.ndarray,
    _sharpness: np.ndarray,
    _cycles_in_step: int,
) -> np.ndarray:
    return weigh(base_weights, ages)


def _in_step(
    base_weights: np.ndarray, ages: np.ndarray, _sharpness: np.ndarray, cycles_in_step: int
) -> np.ndarray:
    return hold.in_step(base_weights, ages, cycles_in_step)


_HOLDS: dict[str, Callable[[Scenario], HoldPolicy]] = {
    "decayed": lambda s: HoldPolicy(
        partial(_decayed, s.decay),
        carried=True,
        by_sharpness=s.determinant_weights,
    ),
    "predict": lambda _: HoldPolicy(partial(_by_age, hold.full), carried=True),
    "raw": lambda _: HoldPolicy(partial(_by_age, hold.full), carried=False),
    "drop": lambda _: HoldPolicy(partial(_by_age, hold.drop), carried=False),
    "renormalise": lambda _: HoldPolicy(partial(_by_age, hold.renormalise), carried=False),
    "in-step": lambda _: HoldPolicy(_in_step, carried=False),
}


# --- the rules -----------------------------------------------------------------------------------


def _require_the_average(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    # Only here: whoever checks a scenario may be slow to start, a node of the network may not.
    from topology.weights import check_doubly_stochastic

    try:
        check_doubly_stochastic(weights)
    except ValueError as error:
        raise ValueError(
            f"rule {scenario.rule} multiplies the network's average by the number of nodes, and "
            f"needs weights that lead there: {error}; or choose rule hcmci, which takes any"
        ) from None


def _require_honest_majorities(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    # A node that is alone has nobody to fear.
    needed = 2 * scenario.liars if len(neighbours) > 1 else 0
    few = [node for node, heard in enumerate(neighbours) if len(heard) < needed]
    if few:
        raise ValueError(
            f"rule trimmed-ci --liars {scenario.liars} on graph {scenario.graph}: node {few[0]} "
            f"hears {len(neighbours[few[0]])} neighbours and must hear {needed} to tell liars from "
            "others; use a denser --graph, fewer --liars, or rule ci, which believes everybody"
        )


def _require_all_at_once(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    everybody = len(neighbours) - 1
    deaf = [node for node, heard in enumerate(neighbours) if len(heard) < everybody]
    if deaf:
        raise ValueError(
            f"rule centralised on graph {scenario.graph}: node {deaf[0]} hears "
            f"{len(neighbours[deaf[0]])} of {everybody} others, and must hear all; use --graph "
            "complete, or rule hcmci, which comes near the centralised filter on any graph"
        )
    if scenario.schedule != "full":
        raise ValueError(
            f"rule centralised with --schedule {scenario.schedule}: every node must publish in "
            "every cycle; use --schedule full, or rule hcmci or ci, which do with less"
        )
    if lossy := lossy_links(scenario):
        raise ValueError(
            f"rule centralised with {lossy}: every node must hear all others in "
            "every step; leave that out, or use rule hcmci or ci, which do with less"
        )
    if scenario.rounds != 1:
        raise ValueError(
            f"rule centralised with --rounds {scenario.rounds}: one round tells everybody all, "
            "and a second would tell it twice; use --rounds 1"
        )


_RULES: dict[str, Rule] = {
    "ci": Rule(
        "covariance intersection: consistent for any correlation, never less tight than wac",
        lambda n, _: packed_length(n),
        partial(averaging_numbers, INFORMATION),
        holds=True,
        fleet=partial(averaging_fleet, INFORMATION),
        shares_beliefs=True,
    ),
    "trimmed-ci": Rule(
        "ci that --liars of a node's neighbours cannot drag away; needs twice as many neighbours",
        lambda n, _: packed_length(n),
        trimmed,
        holds=True,
        check=_require_honest_majorities,
        shares_beliefs=True,
        own=("liars",),
        ignores=("determinant_weights",),
    ),
    "wac": Rule(
        "weighted average of means and covariances (the paper's): no inverse, may diverge",
        lambda n, _: packed_length(n),
        partial(averaging_numbers, MOMENTS),
        holds=True,
        fleet=partial(averaging_fleet, MOMENTS),
        shares_beliefs=True,
    ),
    "hcmci": Rule(
        "consensus on prior and novelty, safe gain: consistent, near centralised with more rounds",
        lambda n, nodes: 2 * packed_length(n) + nodes,
        partial(hybrid, safe_gain),
        fleet=partial(hybrid_fleet, safe_gain),
    ),
    "hcmci-classical": Rule(
        "as hcmci with the number of nodes as gain: overconfident before the rounds converge",
        lambda n, nodes: 2 * packed_length(n) + nodes,
        partial(hybrid, classical_gain),
        fleet=partial(hybrid_fleet, classical_gain),
        check=_require_the_average,
    ),
    "icf": Rule(
        "information-weighted consensus: hcmci-classical in the bytes of ci, as overconfident",
        lambda n, _: packed_length(n),
        weighted_information,
        fleet=weighted_information_fleet,
        check=_require_the_average,
    ),
    "diffusion": Rule(
        "readings of the neighbours, then averaged means; covariance not fused: not consistent",
        lambda n, _: packed_length(n),
        diffused,
        fleet=diffused_fleet,
    ),
    "kcf": Rule(
        "readings of the neighbours, then a pull to their means: not consistent, takes no weights",
        lambda n, _: packed_length(n) + n,
        pulled,
        fleet=pulled_fleet,
        ignores=("weights",),
    ),
    "labelled": Rule(
        "measurements with labels, each counted once: near centralised in a fraction of the bytes",
        None,
        flooding,
        relays=True,
        check=check_labelled,
        fleet=flooding_fleet,
        lacking=without_arrays,
        own=LABELLED_FIELDS,
        ignores=("weights", "number"),
    ),
    "local": Rule(
        "every node alone: publishes, but fuses nothing",
        lambda n, _: packed_length(n),
        partial(averaging, keep_own),
        fleet=local_fleet,
        shares_beliefs=True,
        ignores=("weights",),
    ),
    "centralised": Rule(
        "all readings at every node: the optimum; complete graph, full schedule, one round",
        lambda n, _: packed_length(n),
        diffused,
        fleet=diffused_fleet,
        check=_require_all_at_once,
        ignores=("weights",),
    ),
    "ellipsoid": Rule(
        "sets that hold the truth for certain: ellipsoids that intersect; needs bounded noise",
        lambda n, _: packed_length(n),
        set_rules.ellipsoids,
        holds=True,
        check=set_rules.check_bounded,
        certain=True,
        listen=partial(set_rules.listen, Ellipsoids),
        ignores=("weights", "decay", "determinant_weights"),
    ),
    "zonotope": Rule(
        "the same with zonotopes: tighter prediction, wider shares; needs bounded noise",
        lambda n, _: n + n**2,
        set_rules.zonotopes,
        holds=True,
        check=set_rules.check_bounded,
        certain=True,
        listen=partial(set_rules.listen, Zonotopes),
        ignores=("weights", "decay", "determinant_weights"),
    ),
}
RULE_SUMMARIES = {name: rule.summary for name, rule in _RULES.items()}
