"""Reasons why the environment process cannot begin, or cannot go on."""

from concord.runtime.processes.environment.notices import Hello


class Disagreement(Exception):
    """A node was started with another configuration than the environment."""


class Deserted(Exception):
    """Every node is gone."""


def compare(hello: Hello, fingerprint: str) -> None:
    """Compare a node's configuration with the environment's.

    Raises:
        Disagreement: it does not.
    """
    if hello.fingerprint != fingerprint:
        raise Disagreement(
            f"node {hello.node} runs configuration {hello.fingerprint[:12]!r}, the environment "
            f"{fingerprint[:12]!r}; give all the same setup and version"
        )
