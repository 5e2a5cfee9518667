"""The messages of a recording, kept as numbers until its steps are known."""

import numpy as np

from concord.nodes.changes import Event
from concord.nodes.messages import (
    Bid,
    Estimate,
    Grant,
    Measured,
    ReportedTracks,
    Timing,
    Truth,
    from_wire,
)
from concord.results.bus.bus_record import BusRecord
from concord.results.records.extras import run_extras
from concord.results.records.step_rows import StepRows
from concord.runtime.recorded import SharedFrame, fits, meaning
from concord.runtime.recording import DAMAGE
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import FloodingRule, smoothing_lags


class HeardMessages:
    """The messages of a run of N nodes, in the order of a recording.

    Attributes:
        truths, controls: states (n,) and controls (p,), by step.
        estimates: rows of `mean`, `cov`, `ages`, `suspect`, `age_s`, `gap`, `smoothed` and
            `smoothed_std`. A message that does not fit the setup is no row.
        tracks: what nodes tell beside, by (step, node); empty for scenarios without `RunExtras`.
        on_bus, events: frames, bids and grants; what changed in the run.
        timed: nodes told how they kept their time. damaged_bytes: of the recording.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup, self._frames = setup, frame_format(setup.scenario)
        nodes, n = setup.scenario.nodes, len(setup.prior_mean)
        lags = (smoothing_lags(setup.scenario.rule), n)
        self.truths: dict[int, np.ndarray] = {}
        self.controls: dict[int, list[float]] = {}
        self.estimates = StepRows(
            nodes,
            {
                "mean": (n,),
                "cov": (n * (n + 1) // 2,),
                "ages": (nodes,),
                "suspect": (),
                "age_s": (),
                "gap": (),
                "names": (),
                "smoothed": lags,
                "smoothed_std": lags,
            },
        )
        self._measured: dict[tuple[int, ...], StepRows] = {}
        self._has_tracks = run_extras(setup.scenario) is not None
        self.tracks: dict[tuple[int, int], ReportedTracks | None] = {}
        self.on_bus = BusRecord(nodes, isinstance(setup.scenario.rule, FloodingRule))
        self.events: list[Event] = []
        self.timed, self.damaged_bytes = False, 0
        # By the names of the counters, which are few in number.
        self._counts: dict[tuple[str, ...], StepRows] = {}

    def note(self, topic: str, data: bytes) -> None:
        """Note a message, or pass over bytes that are none."""
        nodes = self._setup.scenario.nodes
        if topic == DAMAGE:
            self.damaged_bytes += int(data)
        said = meaning(topic, data, nodes, self._frames)
        if not fits(said, self._setup):
            return
        match said:
            case SharedFrame(node, fragment):
                payload_bytes = len(data) - self._frames.overhead_bytes
                self.on_bus.note_frame(node, fragment, payload_bytes)
            case Truth() as message:
                self.truths[message.step] = from_wire(message.state)
            case Bid() as message:
                self.on_bus.note_bid(message)
            case Grant() as message:
                self.on_bus.note_grant(message)
            case Measured() as message:
                self._note_measured(message)
            case Estimate() as message:
                self._note_estimate(message)
            case Event() as message:
                self.events.append(message)
            case Timing():
                self.timed = True
            case _:
                pass

    def _note_measured(self, message: Measured) -> None:
        readings = from_wire(message.readings)
        shape = readings.shape
        if shape not in self._measured:
            self._measured[shape] = StepRows(self._setup.scenario.nodes, {"readings": shape})
        self._measured[shape].put(message.step, message.node, readings=readings)
        if message.control is not None:
            self.controls[message.step] = message.control

    def _note_estimate(self, message: Estimate) -> None:
        nodes = self._setup.scenario.nodes
        past = {"smoothed": message.smoothed, "smoothed_std": message.smoothed_std}
        names = tuple(message.counters)
        if names not in self._counts:
            self._counts[names] = StepRows(nodes, {"counts": (len(names),)})
        is_kept = self.estimates.put(
            message.step,
            message.node,
            mean=message.mean,
            cov=message.cov,
            ages=[*message.ages, *[None] * (nodes - len(message.ages))],
            suspect=message.suspect,
            age_s=message.age_s,
            gap=message.gap,
            names=list(self._counts).index(names),
            **{name: told for name, told in past.items() if told},
        )
        if is_kept:
            counts = list(message.counters.values())
            self._counts[names].put(message.step, message.node, counts=counts)
            if self._has_tracks:
                self.tracks[message.step, message.node] = message.tracks

    @property
    def measured(self) -> StepRows:
        """Rows of `readings` (readings, d), of the shape that most have."""
        most = max(self._measured.values(), key=len, default=None)
        return most or StepRows(self._setup.scenario.nodes, {"readings": (0, 0)})

    def counters(self, node: int, there: np.ndarray) -> dict[str, int]:
        """Return the counters in the last estimate of a node in steps that are `there` (steps,);
        none without an estimate."""
        last = max(
            (k for k in np.flatnonzero(there).tolist() if (k, node) in self.estimates), default=None
        )
        if last is None:
            return {}
        names = list(self._counts)[int(self.estimates.row(last, node)["names"])]
        counts = self._counts[names].row(last, node)["counts"]
        return dict(zip(names, counts.astype(int).tolist(), strict=True))
