"""A Monte Carlo of one setup as arrays: the same trace as `trace.py`, all runs at once."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from experiments.drivers import in_memory
from experiments.trace import Trace, read_trace
from filters.metrics import nees
from nodes.messages import Array, to_wire
from scenarios.catalogue import kind_of
from scenarios.setup import Setup, generator


class Histories(NamedTuple):
    """R runs of N nodes; see `trace.Trace`, whose arrays these are with the runs in front.

    truth (R, steps, n), readings (R, steps, N, r, d), control (R, steps, p) or None, mean
    (R, steps, N, n), nees (R, steps, N), payload_bytes (R, steps, rounds, N), ages (R, steps, E)
    over the links: the neighbours of node 0, then those of node 1, and so on.
    """

    truth: Array
    readings: Array
    control: Array | None
    mean: Array
    nees: Array
    ages: np.ndarray
    payload_bytes: np.ndarray


Simulate = Callable[[Setup, range], Histories]


def one_by_one(setup: Setup, runs: range) -> Histories:
    """The runs by the in-process driver."""
    traces = [read_trace(one, in_memory(one)) for one in setups(setup, runs)]
    receivers = [i for i, heard in enumerate(setup.neighbours) for _ in heard]
    senders = [j for heard in setup.neighbours for j in heard]
    controls = [trace.control for trace in traces if trace.control is not None]
    return Histories(
        truth=np.stack([trace.truth for trace in traces]),
        readings=np.stack([trace.readings for trace in traces]),
        control=np.stack(controls) if controls else None,
        mean=np.stack([trace.mean for trace in traces]),
        nees=np.stack([_nees(setup, trace) for trace in traces]),
        ages=np.stack([trace.ages[:, receivers, senders] for trace in traces]),
        payload_bytes=np.stack([trace.payload_bytes for trace in traces]),
    )


def _nees(setup: Setup, trace: Trace) -> Array:
    states = list(kind_of(setup.scenario.name).score.nees_states)
    errors = (trace.mean - trace.truth[:, None])[..., states]
    return nees(errors, trace.cov[..., states, :][..., states])


def setups(setup: Setup, runs: range) -> list[Setup]:
    """The setup of each run: the network is that of all, truth and prior are drawn anew."""
    plant = kind_of(setup.scenario.name).plant(setup.scenario)
    own = []
    for run in runs:
        scenario = msgspec.structs.replace(setup.scenario, run=run)
        drawn = plant.draw(partial(generator, scenario), setup.scenario.steps).initial
        state, mean, cov = plant.initial(drawn)
        own.append(
            msgspec.structs.replace(
                setup, scenario=scenario, initial_state=to_wire(state), prior_mean=mean.tolist(),
                prior_cov=cov.tolist(),
            )
        )  # fmt: skip
    return own
