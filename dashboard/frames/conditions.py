"""Condition of each node as one word, the same for scene, table and bus."""

import numpy as np

from concord.dashboard.frames.frame import StepFrame

DOWN, REJECTED, STALE, BLIND, SEEING = "down", "rejected", "stale", "blind", "up"


def conditions(frame: StepFrame) -> list[str]:
    """One word per node, the most serious that is true.

    `rejected`: it threw a frame away in this step; `stale`: the newest share of a neighbour did not
    reach it; `blind`: none of its sensors delivered anything.
    """
    stage = frame.stage
    stale = np.zeros(stage.nodes, dtype=bool)
    if frame.lost.any():
        stale[stage.heard[frame.lost, 0]] = True
    rejecting = {event.node for event in frame.events if "rejected" in event.text}
    words: list[str] = []
    for node in range(stage.nodes):
        if not frame.alive[node]:
            words.append(DOWN)
        elif node in rejecting:
            words.append(REJECTED)
        elif stale[node]:
            words.append(STALE)
        elif not frame.seen[node]:
            words.append(BLIND)
        else:
            words.append(SEEING)
    return words


def oldest(frame: StepFrame) -> np.ndarray:
    """Per node (N,): cycles since the oldest share that it holds of a neighbour; -1 of none."""
    stage = frame.stage
    ages = np.full(stage.nodes, -1)
    if len(stage.heard):
        np.maximum.at(ages, stage.heard[:, 0], frame.ages)
    return ages


def sender_at(frame: StepFrame, cursor: float) -> tuple[int, float]:
    """Return the sender on the bus at a cursor (-1: none), and the time within the cycle.

    The cursor counts cycles of the step; its fraction is a fraction of the frames of that cycle, so
    that every frame is shown equally long however short it is.
    """
    if not frame.cycles:
        return -1, 0.0
    number = min(int(cursor), len(frame.cycles) - 1)
    frames = frame.cycles[number].frames
    if not frames:
        return -1, 0.0
    place = min(int((cursor - number) * len(frames)), len(frames) - 1)
    middle = (frames[place].start_us + frames[place].end_us) / 2
    return frames[place].node, middle
