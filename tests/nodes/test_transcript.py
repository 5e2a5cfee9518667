"""The golden transcript: three nodes and one lost share, the first page of documentation.

`make stories` writes it anew; read the difference before you commit it.
"""

import os
from pathlib import Path

import numpy as np

from filters.gaussian import Gaussian
from tests.nodes.networks import DECAYED, network, path
from tests.nodes.transcript import tell

FILE = Path(__file__).parent / "testdata" / "three_nodes_one_lost_share.txt"
LOST = {(2, 1, 1)}
INTRODUCTION = """\
Three nodes on a path, 0 - 1 - 2, follow one number. Node 0 can see it, the others are blind.
Each step of the plant has two communication cycles; in each, every node publishes its belief
(mean ± standard deviation) in a FlexRay slot of its own, waits for its neighbours' beliefs, and
fuses them with its own. In cycle 1 the share of node 2 is lost on its way to node 1. Node 1 waits
until the time of the cycle is over, counts a missed share, and makes do with the last share it
holds of node 2. Nobody else notices.
"""


def three_nodes():
    priors = [Gaussian(np.array([mean]), np.array([[1.0]])) for mean in (0.0, 1.0, 2.0)]
    return network(
        path(3),
        priors,
        steps=2,
        rounds=2,
        process_noise_cov=np.array([[0.04]]),
        hold_policy=DECAYED,
        seeing=[0],
        lead=1,
        seed=2,
    )


def test_three_nodes_one_lost_share():
    text = "\n".join([INTRODUCTION.rstrip(), *tell(three_nodes(), LOST)]).rstrip() + "\n"
    if os.environ.get("CONCORD_REWRITE"):
        FILE.write_text(text, encoding="utf-8")
    assert text == FILE.read_text(encoding="utf-8"), (
        "the story of a run has changed; if that is wanted, run `make stories` and read the "
        "difference"
    )
