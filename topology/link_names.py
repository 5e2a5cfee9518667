"""Behaviour of links during a run, by name: `bernoulli:0.1`, `switching:ring,star:10`.

| name | meaning |
|---|---|
| static | links stay |
| measured | a frame arrives with the chance that the graph's source gives for its link |
| bernoulli:P | a link is down with probability P in a step |
| markov:F,R | an up link fails with probability F in a step, a down one comes back with R |
| switching:A,B,...:STEPS | one graph after another, for so many steps each |
| moving:RANGE | a node hears the nodes within RANGE m of its position in the plant | |
moving:RANGE,WANDER,PERIOD | the same, nodes circle around their places: radius in m, steps |
"""

import math
from typing import NamedTuple

from concord.topology.names import unknown_name

NAMES = (
    "static",
    "measured",
    "bernoulli:P",
    "markov:F,R",
    "switching:A,B,...:STEPS",
    "moving:RANGE",
    "moving:RANGE,WANDER,PERIOD",
)
EXAMPLES = {
    "static": "static",
    "measured": "measured",
    "bernoulli": "bernoulli:0.1",
    "markov": "markov:0.05,0.3",
    "switching": "switching:ring,star:10",
    "moving": "moving:300 or moving:300,50,40",
}


class LinkPlan(NamedTuple):
    """Behaviour of links: the name of `NAMES`, its numbers, and the names of its graphs."""

    kind: str
    numbers: tuple[float, ...] = ()
    graphs: tuple[str, ...] = ()


def parse_links(text: str) -> LinkPlan:
    """Return the plan that a name means.

    Raises:
        ValueError: for an unknown name, and for numbers that cannot be, with rule and example.
    """
    kind, _, rest = text.partition(":")
    if kind not in EXAMPLES:
        raise unknown_name("links", text, NAMES)
    if kind == "switching":
        return _switching(text, rest)
    try:
        numbers = tuple(float(field) for field in rest.split(",")) if rest else ()
    except ValueError:
        numbers = (math.nan,)
    rules = {
        "static": (not numbers, "it takes no numbers"),
        "measured": (not numbers, "it takes no numbers"),
        "bernoulli": (
            len(numbers) == 1 and 0 <= numbers[0] < 1,
            "P is the probability that a link is down, at least 0 and below 1",
        ),
        "markov": (
            len(numbers) == 2 and min(numbers) > 0 and sum(numbers) <= 1,
            "F and R are the probabilities of failure and repair, above 0 and together at most 1",
        ),
        "moving": (
            len(numbers) in (1, 3) and min(numbers) > 0 and max(numbers) < math.inf,
            "give the radio range in m, and for nodes that wander also radius in m and period in "
            "steps, all above 0",
        ),
    }
    holds, rule = rules[kind]
    if not holds:
        raise ValueError(f"links {text}: {rule}; for example {EXAMPLES[kind]}")
    return LinkPlan(kind, numbers)


def _switching(text: str, rest: str) -> LinkPlan:
    names, _, every = rest.rpartition(":")
    graphs = tuple(name for name in names.split(",") if name)
    if len(graphs) < 2 or not every.isdecimal() or int(every) < 1:
        raise ValueError(
            f"links {text}: give two graphs or more and the steps that each stays; for example "
            f"{EXAMPLES['switching']}"
        )
    return LinkPlan("switching", (float(every),), graphs)
