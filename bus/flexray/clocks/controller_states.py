"""States of the protocol operation control (POC) of a node (FlexRay 2.1, 2.2 and 7.2)."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clocks.correction import Corrections
from concord.bus.flexray.clocks.settings import ClockSettings, Mask

# pAllowPassiveToActive, chosen: no cluster states it.
PASSIVE_TO_ACTIVE_PAIRS = 2


class PocState(IntEnum):
    """State of a node's controller. Values from `ACTIVE` on are those of a cluster that runs."""

    LISTEN = 0
    COLLISION_RESOLUTION = 1
    CONSISTENCY_CHECK = 2
    GAP = 3
    INITIALIZE_SCHEDULE = 4
    COLDSTART_CHECK = 5
    JOIN = 6
    INTEGRATION_CHECK = 7
    ACTIVE = 8
    PASSIVE = 9
    HALT = 10


STARTUP_SENDERS = (
    PocState.COLLISION_RESOLUTION,
    PocState.CONSISTENCY_CHECK,
    PocState.JOIN,
    PocState.ACTIVE,
)
CORRECTED = (
    PocState.CONSISTENCY_CHECK, PocState.COLDSTART_CHECK, PocState.JOIN, PocState.INTEGRATION_CHECK,
    PocState.ACTIVE, PocState.PASSIVE,
)  # fmt: skip


class Controllers(NamedTuple):
    """The controllers of the nodes, arrays (N,).

    `failed`: cycle pairs in a row without a clock correction. `sound`: pairs in a row with one, of
    a passive node.
    """

    state: Numbers
    failed: Numbers
    sound: Numbers


def controllers(nodes: int, state: PocState) -> Controllers:
    """Return controllers that are all in one state."""
    none = np.zeros(nodes, dtype=np.int64)
    return Controllers(np.full(nodes, state, dtype=np.int64), none, none)


def sent_frames(settings: ClockSettings, state: Numbers) -> Mask:
    """Return which sync nodes send their sync frame, (S,)."""
    of_sender = state[settings.senders]
    startup = settings.starters & np.isin(of_sender, STARTUP_SENDERS)
    return startup | (of_sender == PocState.ACTIVE)


def after_pair(settings: ClockSettings, before: Controllers, done: Corrections) -> Controllers:
    """Return the controllers of a running cluster after an odd cycle (FlexRay 2.1, 2.2.2).

    A correction beyond its limit halts a node at once (pAllowHaltDueToClock is set). Pairs without
    a correction make it passive and then halt it. A passive node with corrections is active again.
    """
    running = (before.state == PocState.ACTIVE) | (before.state == PocState.PASSIVE)
    failed = np.where(done.missing, before.failed + 1, 0)
    halts = done.exceeded | (failed >= settings.halt_pairs)
    passive = failed >= settings.passive_pairs
    was_passive = before.state == PocState.PASSIVE
    sound = np.where(was_passive & ~done.missing, before.sound + 1, 0)
    state = np.where(
        was_passive & (sound < PASSIVE_TO_ACTIVE_PAIRS),
        PocState.PASSIVE,
        PocState.ACTIVE,
    )
    state = np.where(passive, PocState.PASSIVE, state)
    state = np.where(halts, PocState.HALT, state)
    return Controllers(
        np.where(running, state, before.state),
        np.where(running, failed, before.failed),
        np.where(running, sound, before.sound),
    )
