"""The network of a scenario: its nodes, its graph, and the faults of its links."""

from typing import Annotated

import msgspec

from concord.scenarios.types.option import Option


class SensorNetwork(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Nodes, the graph of who hears whom, consensus weights, and what links do to frames."""

    nodes: Annotated[int, Option("Number of sensor nodes.", at_least=1)]
    graph: Annotated[
        str,
        Option("Graph of the network: ring, path, star, grid, complete, 4-regular, geometric, "
               "file:PATH, FILE.py:NAME, ...", is_setting=True),
    ]  # fmt: skip
    weights: Annotated[
        str,
        Option("Consensus weights: metropolis, maximum-degree, best-constant, fastest-mixing; "
               "equal-neighbour for links that go one way."),
    ] = "metropolis"  # fmt: skip
    links: Annotated[
        str,
        Option("Behaviour of links over time: static, measured (by the graph's own chances), "
               "bernoulli:0.1, markov:0.05,0.3, switching:ring,star:10, moving:300.",
               group="faults"),
    ] = "static"  # fmt: skip
    loss: Annotated[
        float,
        Option("Probability that a link loses a frame on its way to one receiver.",
               group="faults", at_least=0, below=1),
    ] = 0.0  # fmt: skip
