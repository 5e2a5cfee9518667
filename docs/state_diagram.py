"""Draw the state diagrams of node and environment from their transition tables: `make pictures`."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from concord.nodes import environment, node
from concord.nodes.environment_state import EnvironmentPhase
from concord.nodes.node_state import Completion, Phase, Transition

PAGE = Path(__file__).parent / "state_machines.md"

Arrow = tuple[Enum, str, Enum]


def diagram(arrows: Iterator[Arrow], begin: Enum, end: Enum) -> str:
    """Return a Mermaid state diagram; arrows between the same phases share one label."""
    labels: dict[tuple[Enum, Enum], list[str]] = defaultdict(list)
    for before, label, after in arrows:
        if label not in labels[before, after]:
            labels[before, after].append(label)
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {begin.name}"]
    lines += [
        f"    {before.name} --> {after.name}: {', '.join(told)}"
        for (before, after), told in labels.items()
    ]
    return "\n".join([*lines, f"    {end.name} --> [*]", "```"])


def arrows_of(
    transitions: Mapping[Any, Mapping[type, Transition]],
    completions: Mapping[Any, tuple[Completion, ...]],
) -> Iterator[Arrow]:
    """Yield the arrows of a machine; an event that changes no phase has none."""
    for phase, row in transitions.items():
        for event, transition in row.items():
            for after in transition.leads_to:
                if after is not phase:
                    yield phase, event.__name__, after
        for completion in completions.get(phase, ()):
            for after in completion.leads_to:
                yield phase, completion.is_due.__name__.replace("_", " "), after


def diagrams() -> dict[str, str]:
    """Return the diagram of each machine by its name."""
    changed: Arrow = (Phase.CHANGE, "changes applied", Phase.MEASUREMENT)
    of_node = [*arrows_of(node.TRANSITIONS, node.COMPLETIONS), changed]
    of_environment = arrows_of(environment.TRANSITIONS, {})
    return {
        "node": diagram(iter(of_node), Phase.MEASUREMENT, Phase.FINISHED),
        "environment": diagram(of_environment, EnvironmentPhase.HELD, EnvironmentPhase.FINISHED),
    }


def drawn(page: str) -> str:
    """Return the page with its diagrams drawn anew."""
    for name, text in diagrams().items():
        pattern = rf"(<!-- {name} -->\n).*?(\n<!-- end -->)"
        page = re.sub(
            pattern, lambda found, text=text: found[1] + text + found[2], page, flags=re.S
        )
    return page


def main() -> None:
    """Draw the diagrams of the page."""
    PAGE.write_text(drawn(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
