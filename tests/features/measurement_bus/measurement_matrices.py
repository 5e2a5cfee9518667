"""The measurement bus under FlexRay in the paper's matrices: equations (2), (6) to (9).

One slot maps measurement and held measurement to what is received, ybar_s = N_s y_s + Theta_s
ybar_{s-1}. Sensors may measure vectors: where the paper has a one or a delta, there is a block.

Source: Meng et al. (2025), section 2. Read with q = ceil(s / l1) in (2), whose printed R_1 lists
only the first and the last static slot, and R_2 = {q l1}.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class SlotMatrices(NamedTuple):
    """fresh N_s (m, m) picks what is transmitted, held Theta_s (m, m) what is kept: (9)."""

    fresh: np.ndarray
    held: np.ndarray


def static_turn(slot: int, static_slots: int) -> int:
    """vartheta_s of (2): whose static slot s is, 1..l; 0 in a dynamic slot."""
    cycle_length = static_slots + 1
    if slot % cycle_length == 0:
        return 0
    cycle = -(-slot // cycle_length)
    return (slot - cycle) % static_slots + 1


def segment(slot: int, static_slots: int) -> int:
    """p_s of (8): 0 in the static segment, 1 in the dynamic one."""
    return int(slot % (static_slots + 1) == 0)


def selection(members: Sequence[int], sizes: Sequence[int], chosen: int) -> np.ndarray:
    """Phi: diagonal of the blocks delta(j, chosen) I of the members j (sensors 1..N)."""
    return np.diag(
        np.repeat([float(j == chosen) for j in members], [sizes[j - 1] for j in members])
    )


def slot_matrices(
    sizes: Sequence[int], static_slots: int, slot: int, contention_winner: int
) -> SlotMatrices:
    """The matrices of (9) in slot s.

    Args:
        sizes: m_1..m_N.
        static_slots: l, 1..N-1.
        slot: s, from 1 on.
        contention_winner: tau_s of (4) if s is a dynamic slot (otherwise it is not looked at).
    """
    static = range(1, static_slots + 1)
    contending = range(static_slots + 1, len(sizes) + 1)
    split, total = sum(sizes[:static_slots]), sum(sizes)
    to_static = np.eye(total)[:, :split]  # I1bar
    to_contending = np.eye(total)[:, split:]  # I2bar
    p = segment(slot, static_slots)
    phi_static = selection(static, sizes, static_turn(slot, static_slots))
    phi_contending = selection(contending, sizes, contention_winner if p else 0)
    theta_static = np.hstack([to_static @ (np.eye(split) - phi_static), to_contending])
    theta_contending = np.hstack(
        [to_static, to_contending @ (np.eye(total - split) - phi_contending)]
    )
    return SlotMatrices(
        (1 - p) * to_static @ phi_static @ to_static.T
        + p * to_contending @ phi_contending @ to_contending.T,
        (1 - p) * theta_static + p * theta_contending,
    )


def receive(matrices: SlotMatrices, measurement: np.ndarray, received: np.ndarray) -> np.ndarray:
    """ybar_s (..., m) of y_s (..., m) and ybar_{s-1} (..., m): (9)."""
    return measurement @ matrices.fresh.T + received @ matrices.held.T


def receive_by_segments(
    sizes: Sequence[int],
    static_slots: int,
    slot: int,
    contention_winner: int,
    measurement: np.ndarray,
    received: np.ndarray,
) -> np.ndarray:
    """The same by (6) and (7): the static sensors' part and the contenders' part, stacked."""
    split = sum(sizes[:static_slots])
    members, own = range(1, static_slots + 1), slice(0, split)
    chosen = static_turn(slot, static_slots)
    if segment(slot, static_slots):
        members, own = range(static_slots + 1, len(sizes) + 1), slice(split, None)
        chosen = contention_winner
    phi = selection(members, sizes, chosen)
    after = received.copy()
    after[..., own] = measurement[..., own] @ phi + received[..., own] @ (np.eye(len(phi)) - phi)
    return after
