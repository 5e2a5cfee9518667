"""Why a world cannot begin, or cannot go on."""

from nodes.notices import Hello


class Disagreement(Exception):
    """A node was started with another configuration than the world."""


class Deserted(Exception):
    """Every node is gone."""


def compare(hello: Hello, fingerprint: str) -> None:
    """Whether a node runs what the world runs.

    Raises:
        Disagreement: it does not.
    """
    if hello.fingerprint != fingerprint:
        raise Disagreement(
            f"node {hello.node} runs configuration {hello.fingerprint[:12]!r}, the world "
            f"{fingerprint[:12]!r}; give all the same setup, version and kernels"
        )
