"""Energy of transmission for nodes on batteries: the first-order radio model.

Source: Heinzelman, Chandrakasan, Balakrishnan (2000), "Energy-efficient communication protocol for
wireless microsensor networks", section 2. Electronics take 50 nJ per bit at the sender and at every
receiver. The amplifier takes 100 pJ per bit and square metre of the range. Nodes without positions
share one wire, so only the electronics count. Idle listening is not counted.
"""

from collections.abc import Sequence

import numpy as np

ELECTRONICS_NJ_PER_BIT = 50.0
AMPLIFIER_NJ_PER_BIT_M2 = 0.1


def energy_per_bit_nj(
    neighbours: Sequence[Sequence[int]], positions_m: np.ndarray | None
) -> np.ndarray:
    """Per node (N,), what a bit of its costs sender and hearers together, in nJ.

    `neighbours` says whom each node hears; `positions_m` (N, 2), or None for a wire.
    """
    nodes = len(neighbours)
    hearers = np.zeros(nodes)
    reach_m = np.zeros(nodes)
    for node, heard in enumerate(neighbours):
        for sender in heard:
            hearers[sender] += 1
            if positions_m is not None:
                distance_m = float(np.linalg.norm(positions_m[node] - positions_m[sender]))
                reach_m[sender] = max(reach_m[sender], distance_m)
    return ELECTRONICS_NJ_PER_BIT * (1 + hearers) + AMPLIFIER_NJ_PER_BIT_M2 * reach_m**2
