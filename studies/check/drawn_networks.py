"""Random networks without faults, each drawn from its number.

`concord check` runs a rule in them. The developers' laboratory adds a swarm of faults to them.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from concord.entries import summaries
from concord.scenarios.bus_table.bus_plan import arbiter_names, schedule_names
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_with_known

_ATTEMPTS = 200

LINEAR_LOOPS = (
    "cruise-control",
    "suspension",
    "aircraft-pitch",
    "dc-motor-speed",
    "dc-motor-position",
)
# The filters know these plants as they are.
EXACT_PLANTS = ("oscillator", *LINEAR_LOOPS)
_PLANTS = {
    "oscillator": 6,
    "target-tracking": 5,
    "target-crossing": 3,
    **dict.fromkeys(LINEAR_LOOPS, 1),
    "meng2025-network": 1,
    "liu2021-network": 3,
}
_CERTAIN = ("ellipsoid", "zonotope")
# Rules that only scenarios of their own have, and one that takes some cases of ci.
_OWN = ("reception", "track-ci", "sharp-ci", *_CERTAIN)
# The order decides which number draws which rule; new rules follow at the end.
_RULES = {
    "ci": 5, "hcmci": 4, "labelled": 5, "wac": 3, "trimmed-ci": 3, "icf": 2, "diffusion": 1,
    "kcf": 1, "labelled-ellipsoid": 1, "local": 1, "centralised": 1,
}  # fmt: skip
_RULES |= {rule: 1 for rule in summaries("RULES") if rule not in {*_RULES, *_OWN}}
_GRAPHS = ("ring", "path", "star", "complete", "grid", "erdos-renyi", "scale-free", "3-regular")
_HOLDS = ("decayed", "decayed", "predict", "drop", "renormalise", "in-step", "raw")
_HOLDS_OF_SETS = {"decayed": "predict", "renormalise": "drop", "in-step": "drop"}
_LINKS = ("static", "static", "static", "bernoulli:0.2", "markov:0.1,0.5", "switching:ring,star:4")


def possible_networks(number: int) -> Iterator[tuple[int, np.random.Generator, Scenario]]:
    """Yield networks of a number that can run: the attempt, its generator, and the scenario."""
    for attempt in range(_ATTEMPTS):
        generator = generator_of(number, attempt, 0)
        try:
            drawn = _drawn(generator)
            prepare(drawn)
        except ValueError:
            continue
        yield attempt, generator, drawn


def generator_of(number: int, attempt: int, purpose: int) -> np.random.Generator:
    """Return the stream of a purpose in an attempt to draw a network."""
    return np.random.default_rng(np.random.SeedSequence(number, spawn_key=(attempt, purpose)))


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
    if name in (*LINEAR_LOOPS, "liu2021-network"):
        asked["control"] = one("truth", "0", "1")
    if rule == "ci" and generator.spawn(1)[0].random() < 1 / 3:
        asked["rule"] = "sharp-ci"
    return scenario_with_known(name, **asked)[0]


def _weighted(generator: np.random.Generator, weights: Mapping[str, int]) -> str:
    chances = np.array(list(weights.values()), dtype=float)
    return list(weights)[int(generator.choice(len(chances), p=chances / chances.sum()))]
