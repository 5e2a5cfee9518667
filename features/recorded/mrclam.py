"""Tracking on real data: one robot of a MRCLAM recording is the target, the others see it.

Everything is looked up by step; nothing is random. The rules are those of the project's study of
MRCLAM set 6, with no parameter that belongs to that set.
"""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from concord.features.recorded.confined_motion import ConfinedMotion
from concord.features.recorded.mrclam_files import Recording
from concord.features.recorded.sighting import Sighting
from concord.plants.placement import Draws, GeneratorFor

STAMP_DELAY_S = 0.045  # a measurement is stamped so much after its picture
GAP_MAX_S = 0.5  # between samples of ground truth that may be interpolated
_READING = 5  # range, bearing, and the observer's x, y, heading


@dataclass(frozen=True, eq=False)
class RecordedTarget:
    """A plant that replays a recording, one row of its arrays per step.

    The truth is [px, py, vx, vy]. It is NaN where no two samples of ground truth less than
    `GAP_MAX_S` apart bracket the time of the step, and after the end. Its velocity is a difference
    of positions (NaN beside a gap), made for looking at, not for scoring.
    """

    target: int
    robots: tuple[int, ...]  # which robot each node is
    truth: np.ndarray  # (steps, 4)
    node_positions_m: np.ndarray  # (steps, nodes, 2), NaN as the truth
    delivered: np.ndarray  # (steps, nodes, readings, 5), NaN where nothing was seen
    model: ConfinedMotion = field(default_factory=ConfinedMotion)
    sensors: Sighting = field(default_factory=Sighting)

    state_names = ("px", "py", "vx", "vy")
    state_units = ("m", "m", "m/s", "m/s")

    @property
    def nodes(self) -> int:
        return len(self.robots)

    @property
    def steps(self) -> int:
        """Return the number of instants on record."""
        return len(self.truth)

    @property
    def time_step_s(self) -> float:
        return self.model.time_step_s

    def sensor(self, node: int) -> Sighting:
        """Return the sensor of one node."""
        return self.sensors.for_node(node)

    def positions(self, step: int) -> np.ndarray:
        """Where the nodes are: (nodes, 2) in m."""
        return self.node_positions_m[step]

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Nothing is random: empty and zero arrays of the right shapes.

        Raises:
            ValueError: for more steps than there are on record.
        """
        if steps > self.steps:
            raise ValueError(
                f"{steps} steps, but the recording of target {self.target} has {self.steps} "
                f"of {self.time_step_s:g} s; ask for {self.steps} or fewer"
            )
        shape = (steps, *self.delivered.shape[1:])
        return Draws(np.empty(0), np.empty((steps, 0)), np.broadcast_to(0.0, shape))

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., 4), prior mean (..., 4) and prior cov (4, 4) for noise (..., 0)."""
        shape = (*noise.shape[:-1], 4)
        mean, cov = self.model.stationary_mean, self.model.stationary_cov
        return np.broadcast_to(self.truth[0], shape), np.broadcast_to(mean, shape), cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """Return the recorded state of the next step for states (..., 4), NaN after the end."""
        after = self.truth[step + 1] if step + 1 < self.steps else np.nan
        return np.broadcast_to(after, state.shape)

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the recorded readings of the step for noise (..., nodes, readings, 5)."""
        return np.broadcast_to(self.delivered[step], noise.shape)


def recorded_target(recording: Recording, target: int) -> RecordedTarget:
    """The plant whose target is a robot of the recording and whose nodes are the others, ascending.

    Raises:
        ValueError: for a robot that the recording lacks, one without a barcode, no other robots, or
            ground truths that do not overlap in time.
    """
    robots = tuple(robot for robot in recording.robots if robot != target)
    _require_target(recording, target, robots)
    model = ConfinedMotion()
    times = _times(recording, model.time_step_s)
    position = _pose(recording, target, times)[:, :2]
    velocity = np.gradient(position, model.time_step_s, axis=0)
    nodes = [_pose(recording, robot, times)[:, :2] for robot in robots]
    return RecordedTarget(
        target=target,
        robots=robots,
        truth=np.concatenate([position, velocity], axis=1),
        node_positions_m=np.stack(nodes, axis=1),
        delivered=_delivered(recording, target, robots, times, model.time_step_s),
        model=model,
    )


def _require_target(recording: Recording, target: int, robots: tuple[int, ...]) -> None:
    known = ", ".join(map(str, recording.robots))
    if target not in recording.robots:
        raise ValueError(
            f"{recording.folder}: no robot {target} to track; choose one of the robots {known}"
        )
    if target not in recording.barcodes:
        raise ValueError(
            f"{recording.folder / 'Barcodes.dat'}: no barcode of robot {target}; add its row"
        )
    if not robots:
        raise ValueError(f"{recording.folder}: robot {known} is alone; add one that sees it")


def _times(recording: Recording, time_step_s: float) -> np.ndarray:
    """Return the instants t_k (steps,) that all ground truths span, absolute in s."""
    begin = max(robot.truth[0, 0] for robot in recording.robots.values())
    end = min(robot.truth[-1, 0] for robot in recording.robots.values())
    steps = int((end - begin) / time_step_s + 1e-9) + 1
    if end < begin or steps < 2:
        raise ValueError(
            f"{recording.folder}: all robots together have ground truth for {end - begin:.3f} s "
            f"only, less than one step of {time_step_s:g} s; use files of one recording"
        )
    return begin + time_step_s * np.arange(steps)


def _pose(recording: Recording, robot: int, times: np.ndarray) -> np.ndarray:
    """x, y and unwrapped heading (t, 3) at `times` (t,) within the ground truth, NaN in gaps."""
    truth = recording.robots[robot].truth
    stamps = truth[:, 0]
    before = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, len(stamps) - 2)
    gap = stamps[before + 1] - stamps[before]
    columns = (truth[:, 1], truth[:, 2], np.unwrap(truth[:, 3]))
    pose = np.stack([np.interp(times, stamps, column) for column in columns], axis=-1)
    return np.where(gap[:, None] < GAP_MAX_S, pose, np.nan)


def _delivered(
    recording: Recording,
    target: int,
    robots: tuple[int, ...],
    times: np.ndarray,
    time_step_s: float,
) -> np.ndarray:
    """All readings by step, node and order in time: (steps, nodes, readings, 5), NaN for none.

    A measurement belongs to the first instant at or after its picture; `readings` is the most that
    one node had at one step (at least 1).
    """
    taken: dict[tuple[int, int], list[np.ndarray]] = defaultdict(list)
    for node, robot in enumerate(robots):
        for step, reading in _readings(recording, target, robot, times, time_step_s):
            taken[step, node].append(reading)
    most = max(map(len, taken.values()), default=1)
    delivered = np.full((len(times), len(robots), most, _READING), np.nan)
    for (step, node), readings in taken.items():
        delivered[step, node, : len(readings)] = readings
    return delivered


def _readings(
    recording: Recording, target: int, robot: int, times: np.ndarray, time_step_s: float
) -> list[tuple[int, np.ndarray]]:
    """Step and reading (5,) of each usable sighting of the target by a robot, in time order."""
    rows = recording.robots[robot].measurements
    rows = rows[rows[:, 1] == recording.barcodes[target]]
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    taken_at = rows[:, 0] - STAMP_DELAY_S
    pose = _pose(recording, robot, taken_at)
    usable = (times[0] < taken_at) & (taken_at <= times[-1]) & np.isfinite(pose).all(axis=1)
    steps = np.ceil((taken_at[usable] - times[0]) / time_step_s - 1e-9).astype(int)
    readings = np.concatenate([rows[usable, 2:4], pose[usable]], axis=1)
    return list(zip(steps.tolist(), readings, strict=True))
