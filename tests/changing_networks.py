"""Random changes of a network, of those that can follow upon one another."""

from hypothesis import reject
from hypothesis import strategies as st

from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario

VERBS = ("kill", "restart", "cut", "heal", "loss", "loss on")


@st.composite
def changing(
    draw: st.DrawFn,
    scenarios: st.SearchStrategy[Scenario],
    set_to: tuple[str, ...] = (),
    verbs: tuple[str, ...] = VERBS,
) -> Scenario:
    """Draw one of these scenarios with up to six changes: these verbs and other settings."""
    asked = draw(scenarios)
    neighbours = prepare(asked).neighbours
    steps = sorted(draw(st.lists(st.integers(0, asked.steps - 1), min_size=1, max_size=6)))
    lines: list[str] = []
    absent: set[int] = set()
    for step in steps:
        choices = []
        for verb in (*verbs, *(f"set {wish}" for wish in set_to)):
            choices += _lines(verb, neighbours, absent)
        if choices:
            # The verb first, so that networks with many links are not cut all the time.
            verb = draw(st.sampled_from(sorted({line.split()[0] for line in choices})))
            line = draw(st.sampled_from([one for one in choices if one.split()[0] == verb]))
            absent = _absent(absent, line.split())
            lines.append(f"{step} {line}")
    changed = asked.with_(changes=tuple(lines))
    try:
        prepare(changed)
    except ValueError:
        # Settings that this graph or bus cannot have.
        reject()
    return changed


def _lines(verb: str, neighbours: list[list[int]], absent: set[int]) -> list[str]:
    """Return the lines that a verb allows in a network from which the absent nodes are out."""
    nodes = range(len(neighbours))
    links = [(sender, receiver) for receiver in nodes for sender in neighbours[receiver]]
    match verb:
        case "kill" if len(absent) + 1 < len(nodes):
            return [f"kill {node}" for node in nodes if node not in absent]
        case "restart":
            return [f"restart {node}" for node in absent if set(neighbours[node]) - absent]
        case "cut" | "heal":
            return [f"{verb} {s} {r}{way}" for s, r in links for way in ("", " one-way")]
        case "loss":
            return ["loss 0", "loss 0.4"]
        case "loss on":
            return [f"loss 0.5 {s} {r}" for s, r in links]
        case _:
            return [verb] if verb.startswith("set ") else []


def _absent(absent: set[int], words: list[str]) -> set[int]:
    match words:
        case ["kill", node]:
            return absent | {int(node)}
        case ["restart", node]:
            return absent - {int(node)}
    return absent
