"""Why a world cannot begin, or cannot go on."""


class Disagreement(Exception):
    """A node was started with another configuration than the world."""


class Deserted(Exception):
    """Every node is gone."""
