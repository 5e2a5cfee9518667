"""Warnings before a run: options of a rule on this network that fail or have no effect."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from concord.nodes.messages import from_wire
from concord.nodes.rules.labelled.frame import MAX_WINDOW_STEPS
from concord.nodes.rules.labelled.record_codec import Calibrated
from concord.scenarios.build import build_bus
from concord.scenarios.bus_table.bus_definition import bus_notes
from concord.scenarios.bus_table.bus_plan import contenders_and_room, senders_of
from concord.scenarios.catalogue import definition_of
from concord.scenarios.links import graph_notes
from concord.scenarios.rule_table.labelled import digest_of, latency_steps, window_of
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.scenario import lossy_links
from concord.scenarios.setup import Setup, generator
from concord.scenarios.types.holds import Decayed, Raw
from concord.scenarios.types.rules import (
    DiffusionRule,
    FloodingRule,
    InformationConsensus,
    KalmanConsensus,
    TrimmedCovarianceIntersection,
    WeightedAverage,
    hold_of,
    number_of,
)
from concord.scenarios.types.schedules import (
    URGENCY,
    ContendedSchedule,
    WrittenSchedule,
    arbiter_of,
    occupancy_of,
    trigger_of,
)
from concord.topology.analysis import is_robust, rounds_to
from concord.topology.spectrum import second_eigenvalue_modulus, vote_of
from concord.topology.weights import Weights, from_per_node

# Numerical derivatives put an eigenvalue of 1 a little beside it.
_MARGIN = 1e-6
_DISAGREEMENT = 0.01
# Deviations of a reading from that of the origin within which a format rounds little.
_REACH_OF_RECORDS = {"int12": 511, "int16": 2047, "float32": 16_384}
_REACH_OF_BELIEFS = {"float16": 1023, "float32": 2**18}
_MOST_PREDICTED = 10_000
# Written slots repeat within the cycle counter.
_CYCLES = 64


def warnings_of(setup: Setup) -> tuple[str, ...]:
    """A sentence for every known failure of the setup's rule on its network, and for weights or a
    filter that the rule does not use; empty if none.

    Each names the rule, the condition with its numbers, and what to use instead. Sources are given
    where the conditions are: the functions of `filters/`.
    """
    if definition_of(setup.scenario).wirings:
        return ()
    return (
        *graph_notes(setup.scenario),
        *bus_notes(setup.scenario),
        *_idle_weights(setup),
        *_idle_filter(setup),
        *definition_of(setup.scenario).warnings(setup.scenario),
        *_diverging_average(setup),
        *_too_few_rounds(setup),
        *_raw_hold(setup),
        *_inconsistent(setup),
        *_liars_in_between(setup),
        *_short_window(setup),
        *_never_resent(setup),
        *_ideal_relay(setup),
        *_ideal_arbiter(setup),
        *_starving_order(setup),
        *_beyond_reach(setup),
    )


def _idle_weights(setup: Setup) -> Iterator[str]:
    """Weights of a network whose rule uses none."""
    scenario = setup.scenario
    usual = definition_of(scenario).defaults.network.weights
    if scenario.network.weights != usual and not rule_of(scenario).weighted:
        yield (
            f"--weights {scenario.network.weights} changes nothing here: rule "
            f"{scenario.rule.name} takes no weights; leave it out, or use another rule"
        )


def _idle_filter(setup: Setup) -> Iterator[str]:
    """The filter of a network whose rule keeps sets."""
    scenario = setup.scenario
    usual = definition_of(scenario).defaults.filter
    if scenario.filter != usual and rule_of(scenario).set_valued:
        yield (
            f"--filter {scenario.filter.name} changes nothing here: rule {scenario.rule.name} "
            "keeps sets and has no filter; leave it out, or use another rule"
        )


def _diverging_average(setup: Setup) -> Iterator[str]:
    """wac on an unstable plant: the spectral condition of
    `concord.filters.fusion.averaging.weighted_average`.

    It is about weights that stay. With determinant weights a node loses its vote as its covariance
    grows, and the average stays bounded.
    """
    scenario = setup.scenario
    rule = scenario.rule
    if not isinstance(rule, WeightedAverage):
        return
    if isinstance(rule.hold, Decayed) and rule.hold.determinant_weights:
        return
    if definition_of(scenario).delivery is not None:
        # The bus's deliveries at the start do not show which states a node's sensors see.
        return
    growth = float(np.abs(np.linalg.eigvals(_transition_matrix(setup))).max())
    blind = _blind(setup)
    vote = vote_of(_weights(setup), scenario.rounds, blind)
    if growth**2 * vote <= 1 + _MARGIN:
        return
    mean = growth * vote > 1 + _MARGIN
    what, condition, value = (
        ("estimates and covariances", "rho(F) rho(W^L D)", growth * vote)
        if mean
        else ("covariances", "rho(F)^2 rho(W^L D)", growth**2 * vote)
    )
    yield (
        f"rule wac: {what} diverge, for {condition} is {value:.3g} and must be below 1: the plant "
        f"grows by rho(F) = {growth:.4g} per step, and after {scenario.rounds} rounds the "
        f"{int(blind.sum())} of {scenario.nodes} nodes that see nothing at the start still have a "
        f"vote of rho(W^L D) = {vote:.3g}; use --rule ci, in which they lose it, or --hold decayed "
        "with determinant weights"
    )


def _too_few_rounds(setup: Setup) -> Iterator[str]:
    """Rule icf counts on the average: enough rounds, and no silent node."""
    scenario = setup.scenario
    if not isinstance(scenario.rule, InformationConsensus):
        return
    modulus = second_eigenvalue_modulus(_weights(setup))
    needed = rounds_to(_DISAGREEMENT, modulus)
    if needed is not None and scenario.rounds < needed:
        yield (
            f"rule {scenario.rule.name} is overconfident after {scenario.rounds} rounds: these "
            f"weights leave {modulus:.3g} of a disagreement per round and need {needed} rounds to "
            f"leave {_DISAGREEMENT:.0%}; use --rounds {needed}, or --rule hcmci, which is "
            "consistent after any number"
        )
    if silent := _who_is_silent(setup):
        yield (
            f"rule {scenario.rule.name} is overconfident with {silent}: what is not published is "
            "not averaged, and multiplied by the number of nodes all the same; use --schedule "
            "full, or --rule hcmci"
        )


def _raw_hold(setup: Setup) -> Iterator[str]:
    """A held pair that is not carried on is an estimate of an older state."""
    scenario = setup.scenario
    silent = _who_is_silent(setup)
    if isinstance(hold_of(scenario.rule), Raw) and silent:
        yield (
            f"--hold raw with {silent}: rule {scenario.rule.name} takes shares of former steps for "
            "estimates of the present one and is overconfident without bound; use --hold decayed"
        )


def _inconsistent(setup: Setup) -> Iterator[str]:
    """Rules that do not fuse covariances."""
    scenario = setup.scenario
    if not isinstance(scenario.rule, KalmanConsensus | DiffusionRule):
        return
    yield (
        f"rule {scenario.rule.name} is not consistent: it averages means and not covariances, so "
        "what it reports need not bound its errors; use --rule hcmci or ci where that matters"
    )
    if scenario.rounds == 1:
        yield (
            f"rule {scenario.rule.name} with --rounds 1: the only round exchanges readings, and "
            "means are not averaged afterwards; use --rounds 2 or more"
        )


def _liars_in_between(setup: Setup) -> Iterator[str]:
    """trimmed-ci: what a node is promised holds anywhere, that nodes agree on robust graphs."""
    rule = setup.scenario.rule
    if not isinstance(rule, TrimmedCovarianceIntersection):
        return
    reach = 2 * rule.liars + 1
    robust = is_robust(setup.neighbours, reach)
    if robust:
        return
    what = "is not" if robust is False else "is too large to be shown to be"
    yield (
        f"rule trimmed-ci --liars {rule.liars}: the graph {what} {reach}-robust, so that "
        "honest nodes may not agree with each other while liars speak, though each stays among "
        "what its honest neighbours say; use a denser --graph, such as complete, or fewer --liars"
    )


def _short_window(setup: Setup) -> Iterator[str]:
    """labelled: what comes after its window has passed is lost."""
    scenario = setup.scenario
    if not isinstance(scenario.rule, FloodingRule):
        return
    window = window_of(scenario, setup.neighbours)
    latency = latency_steps(scenario, setup.neighbours)
    if window < latency:
        yield (
            f"rule labelled with a window of {window} steps: on this graph and schedule a record "
            f"may need {latency} to reach everybody, and what comes later is lost; use "
            "--window-steps "
            + (
                f"{latency}"
                if latency <= MAX_WINDOW_STEPS
                else f"{MAX_WINDOW_STEPS} and more slots"
            )
        )


def _never_resent(setup: Setup) -> Iterator[str]:
    """labelled: without digests nobody learns what a link has lost."""
    scenario = setup.scenario
    lossy = lossy_links(scenario)
    is_flooding = isinstance(scenario.rule, FloodingRule)
    if is_flooding and lossy and digest_of(scenario) == 0:
        yield (
            f"rule labelled with {lossy} and no digests: a record that a link "
            "loses is never sent again; leave --digest-steps out, or use 8"
        )


def _ideal_relay(setup: Setup) -> Iterator[str]:
    """Warn of the assumptions behind relaying within a cycle."""
    rule = setup.scenario.rule
    if isinstance(rule, FloodingRule) and rule.relay:
        yield (
            f"--relay: hosts must compose a frame within {rule.latch_delay_us:g} us of the one "
            "before; without --relay nothing of this is assumed"
        )


def _ideal_arbiter(setup: Setup) -> Iterator[str]:
    """Arbiters that know the bids of all nodes."""
    bus = setup.scenario.bus
    name = arbiter_of(bus.schedule)
    if isinstance(bus.schedule, ContendedSchedule) and build_bus(setup).has_ideal_arbiter:
        real = f"--arbiter {URGENCY}, by which the bus itself arbitrates"
        cure = real if bus.serves_urgency else f"--schedule {bus.partial_schedule}, or another bus"
        yield (
            f"--arbiter {name} is ideal on --bus {bus.name}: it compares the bids of all nodes and "
            f"awards slots in any order, which no controller of that bus does; use {cure}"
        )


def _starving_order(setup: Setup) -> Iterator[str]:
    """One frame ID for each node: those with the last IDs send when all others leave room."""
    if arbiter_of(setup.scenario.bus.schedule) != "minislot":
        return
    contenders, room = contenders_and_room(build_bus(setup))
    schedule = setup.scenario.bus.schedule
    if contenders > room and isinstance(schedule, WrittenSchedule):
        yield (
            f"--slots {schedule.slots}: {contenders} nodes contend in dynamic slots, and the "
            f"segment holds {room} of their longest shares in a cycle beside other stations; the "
            "nodes with the last frame IDs may never send; give them static slots, or the frames "
            "before them base cycles that never meet"
        )
    elif contenders > room:
        yield (
            f"--arbiter minislot: {contenders} nodes contend with one frame ID each, and the "
            f"dynamic segment holds {room} of their longest shares in a cycle; while nodes with "
            f"lower IDs ask, the last {contenders - room} may never send; use --arbiter {URGENCY}, "
            "or a cluster with more minislots"
        )


def _who_is_silent(setup: Setup) -> str:
    """Why not everybody is heard in every cycle, in the words of the options; "" if all are."""
    scenario = setup.scenario
    schedule = scenario.bus.schedule
    if (occupancy := occupancy_of(schedule)) < 1:
        return f"--occupancy {occupancy:g}"
    if isinstance(schedule, WrittenSchedule):
        senders = map(build_bus(setup).schedule.static_senders, range(_CYCLES))
        if any(len(row) < scenario.nodes for row in senders):
            return f"--slots {schedule.slots}"
    if without := set(range(scenario.nodes)) - set(senders_of(scenario, setup.neighbours)):
        return f"nodes without data, {', '.join(map(str, sorted(without)))}"
    if lossy := lossy_links(scenario):
        return lossy
    if (trigger := trigger_of(schedule)) > 0:
        return f"--trigger {trigger:g}"
    return ""


def _weights(setup: Setup) -> Weights:
    """The sparse weight matrix (N, N) of a setup."""
    return from_per_node(setup.weights, setup.neighbours)


def _blind(setup: Setup) -> np.ndarray:
    """1.0 (N,) for each node to which the first step delivers nothing, 0.0 for those that see."""
    plant = definition_of(setup.scenario).plant(setup.scenario)
    noise = plant.draw(partial(generator, setup.scenario), 1).measurement[0]
    delivered = plant.observe(from_wire(setup.initial_state), np.zeros_like(noise), 0)
    return np.isnan(delivered).all(axis=(-1, -2)).astype(float)


def _transition_matrix(setup: Setup) -> np.ndarray:
    """Jacobian (n, n) of the undriven model at the prior mean, by central differences.

    The steps are a thousandth of the prior standard deviations, the scale on which a belief looks
    at its model.
    """
    model = definition_of(setup.scenario).model(setup.scenario)
    mean = np.array(setup.prior_mean)
    step = 1e-3 * np.sqrt(np.diag(setup.prior_cov))
    ahead = model.transition(mean + np.diag(step), None, 0)
    behind = model.transition(mean - np.diag(step), None, 0)
    return ((ahead - behind) / (2 * step)[:, None]).T


def _beyond_reach(setup: Setup) -> Iterator[str]:
    """Readings of a plant of the user's own that move far from where numbers are written about."""
    scenario = setup.scenario
    definition, number = definition_of(scenario), number_of(scenario.rule)
    origin, floods = definition.origin(scenario), isinstance(scenario.rule, FloodingRule)
    reach = (_REACH_OF_RECORDS if floods else _REACH_OF_BELIEFS).get(number)
    if origin is None or reach is None or definition.controller(scenario) is not None:
        return
    sensors = {definition.sensor(scenario, node) for node in range(scenario.nodes)} - {None}
    model, state = definition.model(scenario), origin
    for step in range(min(scenario.steps, _MOST_PREDICTED)):
        for sensor in sensors:
            assert isinstance(sensor, Calibrated), "sensors of own plants say their noise"
            away = np.abs(sensor.residual(sensor.measure(state, step), sensor.measure(origin, 0)))
            if (away > reach * sensor.noise_std).any() and (sensor.noise_std > 0).all():
                what = "are sent as float64" if floods else "lose digits, which covariances count"
                option = "record-number" if floods else "number"
                yield (
                    f"--{option} {number}: from step {step} on readings are more than {reach:,} "
                    "standard deviations of their noise away from those of the prior mean, about "
                    f"which numbers are written; they {what}; use --{option} float64, or a prior "
                    "mean nearer to the middle of the motion"
                )
                return
        state = model.transition(state, None, step)
