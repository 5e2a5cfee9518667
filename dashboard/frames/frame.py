"""Frame of the dashboard: the network after one step, as one value."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.bus import Bus, Transmission
from concord.dashboard.frames.innovations import StepNis
from concord.dashboard.frames.stage import Stage
from concord.filters.gaussian import Gaussian


class LogEntry(NamedTuple):
    """Something worth a line in the log; `node` is whom it is about, None for the network.

    `words` are those of the command in a script; "" of what no command asks for.
    """

    step: int
    text: str
    node: int | None = None
    trouble: bool = False
    words: str = ""


class BusCycle(NamedTuple):
    """One communication cycle: its frames in order of time, and who owned a slot and was silent.

    `bus` has the schedule of this cycle: settings change while a network runs. `cycle` counts the
    cycles that carry rounds, `bus_cycle` all cycles of the bus. On a bus without time, times are
    places in the order of slots. `missed` are senders whose frame did not reach a neighbour that
    holds an older one; `rejected` names the nodes that rejected a frame in the step that ends with
    this cycle, with their reasons.
    """

    bus: Bus
    cycle: int
    bus_cycle: int
    frames: tuple[Transmission, ...]
    silent: tuple[int, ...]
    payload_bytes: int
    missed: tuple[int, ...] = ()
    rejected: tuple[str, ...] = ()


class NodeTraffic(NamedTuple):
    """Totals of each node (N,) since the start, in frames."""

    sent: NDArray[np.int64]
    heard: NDArray[np.int64]
    missed: NDArray[np.int64]
    rejected: NDArray[np.int64]


class StepScores(NamedTuple):
    """How good the estimates of a step are; NaN where the truth is not known.

    error, width (N,): of the scored states, and what the node believes of it (square root of the
    trace of its covariance). nees: mean over the nodes. central: error of a filter that hears
    everything. spread: root mean square distance of the nodes' estimates from their mean. nis: of
    the own readings, which needs no truth.
    """

    error: np.ndarray
    width: np.ndarray
    rmse: float
    spread: float
    nees: float
    central: float
    fused: float
    nis: StepNis | None = None


class StepFrame(NamedTuple):
    """The network after step `step`.

    Attributes:
        stage: the fixed part of the picture, with the settings that held in this step.
        truth: (n,), NaN where unknown. belief: of every node, (N, n) and (N, n, n); the last known
        of a node that is down. zonotopes: generators (n, q) of those that keep a zonotope around
        their mean. fused: the mean of all in information form. seen: (N,), who took a reading.
        alive: (N,), who estimated this step. ages: (H,), communication cycles since what a node
        holds of a neighbour was sent, -1 never, in the order of `Stage.heard`. weights: (H,), of
        what it holds, in its last round, NaN where no node told one. lost: (H,), whose newest share
        did not arrive. cut: (E,), links that are cut. rejection: per node, why it last rejected a
        frame. extra: what nodes told beside their beliefs, of stages with an `OwnPage`.
    """

    stage: Stage
    step: int
    time_s: float
    truth: np.ndarray
    belief: Gaussian
    zonotopes: tuple[np.ndarray | None, ...]
    fused: Gaussian
    seen: NDArray[np.bool_]
    alive: NDArray[np.bool_]
    ages: NDArray[np.int64]
    weights: NDArray[np.float64]
    lost: NDArray[np.bool_]
    cut: NDArray[np.bool_]
    traffic: NodeTraffic
    rejection: tuple[str, ...]
    cycles: tuple[BusCycle, ...]
    scores: StepScores
    events: tuple[LogEntry, ...]
    extra: Any = None
