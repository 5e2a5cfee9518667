"""A case from its seed: any scenario that concord runs, and a swarm of faults.

Swarm testing: a case has some of the kinds of faults, each at its own rate, so that no kind hides
what another would bring to light.

Source: Groce, Zhang, Eide, Chen and Regehr (2012), Swarm testing, ISSTA.
"""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from concord.entries import summaries
from concord.experiments.simulation_testing.case import (
    OWN_FIELDS,
    SimulationCase,
    check_case,
    with_fields,
)
from concord.experiments.simulation_testing.script import draw_script
from concord.experiments.simulation_testing.verdict import RECOVERY_STEPS
from concord.experiments.simulation_testing.wire import WIRE_FAULTS
from concord.scenarios.bus_plan import arbiter_names, schedule_names
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import offered_options, scenario_with_known
from concord.topology.names import unknown_name

_ATTEMPTS = 200
_MOST_CALM = 16

_LINEAR = ("cruise-control", "suspension", "aircraft-pitch", "dc-motor-speed", "dc-motor-position")
_PLANTS = {
    "oscillator": 6,
    "target-tracking": 5,
    "target-crossing": 3,
    **dict.fromkeys(_LINEAR, 1),
    "meng2025-network": 1,
    "liu2021-network": 3,
}
_CERTAIN = ("ellipsoid", "zonotope")
_OFTEN = {"ci": 5, "hcmci": 4, "labelled": 5, "wac": 3, "trimmed-ci": 3}
# Rules that only scenarios of their own have.
_OWN = ("reception", "track-ci", *_CERTAIN)
# It takes some cases of ci, so that the others are drawn as ever.
_SHARP = "sharp-ci"
_RULES = _OFTEN | {rule: 1 for rule in summaries("RULES") if rule not in {*_OFTEN, *_OWN, _SHARP}}
_GRAPHS = ("ring", "path", "star", "complete", "grid", "erdos-renyi", "scale-free", "3-regular")
_HOLDS = ("decayed", "decayed", "predict", "drop", "renormalise", "in-step", "raw")
_HOLDS_OF_SETS = {"decayed": "predict", "renormalise": "drop", "in-step": "drop"}
_LINKS = ("static", "static", "static", "bernoulli:0.2", "markov:0.1,0.5", "switching:ring,star:4")


def draw_case(seed: int, fixed: Mapping[str, Any]) -> SimulationCase:
    """Return the case of a seed, of which some fields are fixed.

    Raises:
        ValueError: no scenario has these fields.
    """
    refusal = ValueError("nothing was tried")
    for attempt in range(_ATTEMPTS):
        generator = _generator(seed, attempt, 0)
        try:
            drawn = _drawn(generator)
            prepare(drawn)
        except ValueError:
            continue
        # The fixed fields must not decide which attempt is used; otherwise a case that was made
        # smaller would be a different case.
        try:
            return _completed(seed, attempt, generator, drawn, fixed)
        except ValueError as error:
            refusal = error
    raise refusal


def _completed(
    seed: int,
    attempt: int,
    generator: np.random.Generator,
    drawn: Scenario,
    fixed: Mapping[str, Any],
) -> SimulationCase:
    """Return the case whose scenario was drawn, with what is fixed."""
    calm_step = int(generator.integers(4, _MOST_CALM))
    drawn = msgspec.structs.replace(drawn, steps=calm_step + RECOVERY_STEPS)
    case = SimulationCase(seed, drawn, _draw_wire(generator))
    known = {*offered_options(), *OWN_FIELDS}
    for name in fixed:
        if name not in known:
            raise unknown_name("option", name, known)
    case = with_fields(case, {name: value for name, value in fixed.items() if name != "changes"})
    setup = prepare(case.scenario)
    changes = fixed.get("changes")
    if changes is None:
        calm_step = min(calm_step, case.scenario.steps - 1)
        changes = draw_script(_generator(seed, attempt, 1), setup, calm_step)
    case = with_fields(case, {"changes": tuple(changes)})
    prepare(case.scenario)
    check_case(case)
    return case


def _generator(seed: int, attempt: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(attempt, purpose)))


def _drawn(generator: np.random.Generator) -> Scenario:
    """A scenario that may be impossible."""

    def one(*values: Any) -> Any:
        return values[int(generator.integers(len(values)))]

    name = _weighted(generator, _PLANTS)
    rule = _weighted(generator, _RULES)
    if name == "liu2021-network" and generator.random() < 0.7:
        rule = one(*_CERTAIN)
    schedule = one(*schedule_names())
    asked: dict[str, Any] = {
        "nodes": int(generator.integers(3, one(6, 9, 13))),
        "graph": one(*_GRAPHS, *(("geometric",) * 4 if name.startswith("target") else ())),
        "weights": one("metropolis", "metropolis", "maximum-degree", "equal-neighbour"),
        "rule": rule,
        "rounds": int(generator.integers(1, 4)),
        "steps": 2,
        "seed": int(generator.integers(1, 2**31)),
        "schedule": schedule,
        "occupancy": 1.0 if schedule == "full" else one(0.2, 0.5, 0.8),
        "cluster": one("fitted", "fitted-ab", "fitted-ab", ""),
        "arbiter": one("wtod", *arbiter_names()),
        "trigger": one(0.0, 0.0, 0.0, 0.5),
        "hold": one(*_HOLDS),
        "decay": one(0.0, 0.5, 0.9, 1.0),
        "determinant_weights": one(True, True, False),
        "number": one("float64", "float64", "float32"),
        "links": one(*_LINKS),
        "loss": one(0.0, 0.0, 0.0, 0.05, 0.2),
        # The time of the bus is not tested here.
        "stretch": 1000.0,
    }
    if rule in _CERTAIN:
        asked["hold"] = _HOLDS_OF_SETS.get(asked["hold"], asked["hold"])
    if not asked["cluster"]:
        asked["bus"] = "ideal"
    if rule == "labelled":
        window = one(None, None, 6, 12)
        asked |= {
            "hold": "decayed",
            "trigger": 0.0,
            "relay": one(False, False, True),
            "window_steps": window,
            "digest_steps": one(None, None, 0, 4),
            "record_number": one("int12", "int16", "float32", "float64"),
            "payload_bytes": one(254, 254, 128),
        }
    elif rule == "centralised":
        only = {"graph": "complete", "schedule": "full", "occupancy": 1.0, "rounds": 1}
        asked |= {**only, "loss": 0.0, "links": "static", "hold": "decayed"}
    elif rule == "trimmed-ci":
        # It needs many neighbours, and on most graphs promises little.
        asked["graph"] = one("complete", "complete", "6-regular", asked["graph"])
        asked["nodes"] += 2
    elif rule not in ("ci", "wac", *_CERTAIN):
        asked["hold"] = "decayed"
    if asked["cluster"] == "fitted-ab" and not asked.get("relay"):
        # A stream of its own leaves all other draws as they are without two channels.
        apart = generator.spawn(1)[0]
        asked["channels"] = str(apart.choice(["all", "all", "A", "split", "mixed"]))
    if name in (*_LINEAR, "liu2021-network"):
        asked["control"] = one("truth", "0", "1")
    if rule == "ci" and generator.spawn(1)[0].random() < 1 / 3:
        asked["rule"] = _SHARP
    return scenario_with_known(name, **asked)[0]


def _weighted(generator: np.random.Generator, weights: Mapping[str, int]) -> str:
    chances = np.array(list(weights.values()), dtype=float)
    return list(weights)[int(generator.choice(len(chances), p=chances / chances.sum()))]


def _draw_wire(generator: np.random.Generator) -> tuple[str, ...]:
    """Some kinds, each with a probability between rarely and mostly."""
    return tuple(
        f"{kind} {np.exp(generator.uniform(np.log(0.01), np.log(0.6))):.3f}"
        for kind in WIRE_FAULTS
        if generator.random() < 0.3
    )
