"""Noise of babbling nodes in the frames of others."""

from concord.bus.schedule import Schedule
from concord.nodes.faults.active import EVERYBODY, Faults, hangs
from concord.nodes.faults.passage import Passage


def tried(kind: str, retry: int) -> str:
    """Return the name of a fault's draw for a frame that is sent for the `retry`-th time again."""
    return f"{kind} again {retry}" if retry else kind


def collides(faults: Faults, way: Passage, schedule: Schedule, retry: int = 0) -> bool:
    """Return whether a node babbles in this slot, and nothing blocks it; for every receiver.

    A bus guardian knows the owner of each slot that the schedule gives to one node. It cannot know
    which contender wins a slot of the dynamic segment (FlexRay bus guardian specification 2.0.9).
    """
    owned = way.sender in schedule.static_senders(way.cycle)
    if owned and faults.at("guardian", way.step):
        return False
    babblers = [nodes[0] for kind, nodes in faults.standing if kind == "babble"]
    for node in babblers:
        babble = faults.at("babble", way.step, node)
        if babble is None or node == way.sender or hangs(faults, way.step, node):
            continue
        kind = tried("babble", retry)
        if faults.draw(kind, way.cycle, node, EVERYBODY, way.frame_id) < babble[0]:
            return True
    return False
