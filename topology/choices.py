"""Names of the graphs and weights, without their code.

Apart from the functions that make them, which bring scipy and networkx.
"""

# K stands for a number, PATH for a file of `graph_files`.
GRAPHS = (
    "ring",
    "path",
    "star",
    "grid",
    "complete",
    "erdos-renyi",
    "small-world",
    "scale-free",
    "K-regular",
    "geometric",
    "edges:0-1;1-2",
    "file:PATH",
    "directed:PATH",
    "intel-lab",
    "intel-lab-directed",
)
WEIGHTS = ("metropolis", "maximum-degree", "best-constant", "fastest-mixing", "equal-neighbour")
