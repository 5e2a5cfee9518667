"""Ages of estimates in real time: when they are sent, and until the next ones replace them."""

from itertools import zip_longest

import numpy as np

from concord.nodes.history import History


def peak_ages_s(sent_age_s: np.ndarray, history: History, step_s: float) -> np.ndarray:
    """Return the age that each estimate reached before the next one of its node replaced it.

    This is the peak age of information (Costa, Codreanu and Ephremides, IEEE Transactions on
    Information Theory 62(4), 2016). The age of an estimate ends when its node leaves the network,
    or with the run: other nodes know that a node is out.

    Args:
        sent_age_s: (steps, N), age of each estimate when it was sent; NaN where none came.
        history: which nodes took part in which step, as the events of the run say.
        step_s: from one sampling instant to the next.
    """
    steps, nodes = sent_age_s.shape
    peaks = []
    for node in range(nodes):
        came = np.flatnonzero(np.isfinite(sent_age_s[:, node])).tolist()
        ends = [absent.first_step for absent in history.absent_steps if absent.node == node]
        for step, following in zip_longest(came, came[1:]):
            end = min([end for end in ends if end > step], default=steps)
            if following is None or end <= following:
                peaks.append((end - step) * step_s)
            else:
                peaks.append((following - step) * step_s + sent_age_s[following, node])
    return np.array(peaks)
