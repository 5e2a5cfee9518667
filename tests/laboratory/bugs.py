"""Plant bugs in the real functions, to see whether drawn cases and lives find them.

A bug is a change of the source text of one function. The changed function is compiled and replaces
the original in each module that refers to it.
"""

import importlib
import inspect
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

from tests.laboratory.case import draw_case
from tests.laboratory.case_run import run_case
from tests.laboratory.lives.case import draw_lives
from tests.laboratory.lives.network import run_lives
from tests.laboratory.sound import SOUND

MOST_SEEDS, MOST_LIVES = 100, 200


class Bug(NamedTuple):
    """Bug to plant: `texts` are pairs of a text in a function and its replacement."""

    name: str
    module: str
    function: str
    texts: tuple[tuple[str, str], ...]


BUGS = (
    Bug(
        "a share is used in every part of its cycle",
        "concord.nodes.node", "_close_group",
        (("usable = due if state.phase is Phase.SHARES else config.neighbours",
          "usable = config.neighbours"),),
    ),
    Bug(
        "a share of the next cycle is used before its time",
        "concord.nodes.node", "_close_group",
        (("came.get((cycle, j)) if j in usable",
          "came.get((cycle, j), came.get((cycle + 1, j))) if j in usable"),),
    ),
    Bug(
        "a stale share is taken as fresh",
        "concord.nodes.inbox", "_read",
        (("    if fragment.cycle < cycle:\n        raise Rejected(_LATE)\n    return fragment",
          "    return replace(fragment, cycle=max(fragment.cycle, cycle))"),),
    ),
    Bug(
        "late frames are one cycle less late",
        "concord.nodes.inbox", "_read",
        (("if fragment.cycle < cycle:", "if fragment.cycle < cycle - 1:"),),
    ),
    Bug(
        "a late frame is not counted",
        "concord.nodes.inbox", "hear",
        (("return count(state, _counter(rejected))",
          "return state if rejected.reason == _LATE else count(state, _counter(rejected))"),),
    ),
    Bug(
        "the cycle counter is not checked",
        "concord.bus.flexray.slotted_bus", "SlottedBus.place",
        (("if fragment.count not in (None, self.cycle_count(cycle)):", "if False:"),),
    ),
    Bug(
        "the owner of a slot is not checked",
        "concord.bus.flexray.slotted_bus", "SlottedBus.place",
        (('raise Rejected("wrong-slot")', "return SharePlace(0, frames)"),),
    ),
    Bug(
        "the frame's checksum is not checked",
        "concord.bus.flexray.frame", "decode", (("if not frame_crc_ok:", "if False:"),),
    ),
    Bug(
        "the checksum of a frame that is due is not checked",
        "concord.bus.flexray.share_frames", "whole_body",
        (("and is_intact(frame, slot.checksum_channel)", ""),),
    ),
    Bug(
        "a frame that is due is that of any cycle",
        "concord.bus.flexray.share_frames", "whole_body",
        (("frame.startswith(start)", "frame.startswith(shape.header[:2])"),),
    ),
    Bug(
        "a null frame is read",
        "concord.bus.flexray.share_frames", "read_frame",
        (("if frame.null:", "if False:"),
         # Its payload is zero: cycle 0, which the header contradicts mostly.
         ("frame.cycle_count, ", "None if frame.null else frame.cycle_count, ")),
    ),
    Bug(
        "a cut holds in one direction only",
        "concord.nodes.faults.losses", "hears",
        (("if (sender, receiver) in links.cuts:",
          "if (sender, receiver) in links.cuts and sender < receiver:"),),
    ),
    Bug(
        "who is out is still waited for",
        "concord.nodes.node", "_due", (("if not state.absent:", "if True:"),),
    ),
    Bug(
        "who lost the contest sends all the same",
        "concord.nodes.node", "_take_grant",
        (("if config.index in grant.winners", "if True"),),
    ),
    Bug(
        "all nodes share the slots of node 0",
        "concord.bus.flexray.publication", "Publications.slots",
        (("key = (node, cycle", "key = (0 * node, cycle"),),
    ),
    Bug(
        "nobody grants what no bid asks for",
        "concord.nodes.environment", "_release",
        (("return _grant(config, state, outbox)", "return state"),),
    ),
    Bug(
        "who comes back in vain is not asked again",
        "concord.nodes.run_controller", "RunController._limit",
        (("if any(set(self.config.neighbours[node]) - absent for", "if any(set() for"),),
    ),
    Bug(
        "weights are not renormalised when one is missing",
        "concord.filters.fusion.hold", "_normalise",
        (("return worth / worth.sum(axis=-1, keepdims=True)", "return worth"),),
    ),
    Bug(
        "a held share never ages",
        "concord.nodes.rules.lane_rule",
        "older", (("ages + 1", "ages"),),
    ),
    Bug(
        "a share of an earlier cycle is not dropped",
        "concord.filters.fusion.hold", "drop", (("present = ages == 0", "present = ages >= 0"),),
    ),
    Bug(
        "a covariance is not quite symmetric",
        "concord.filters.fusion.averaging", "Averaging.fuse",
        (("symmetrise(cov)", "cov * (1 + 1e-15 * np.tri(len(cov)))"),),
    ),
    Bug(
        "averaged information weighs twice",
        "concord.filters.fusion.averaging", "Averaging.average",
        (("multiply(numbers.mT, weights)", "multiply(numbers.mT, 2 * weights)"),),
    ),
    Bug(
        "who comes back is far too sure of itself",
        "concord.nodes.node_changes", "_belief",
        (("unpack_upper(from_wire(joined.cov))", "1e-4 * unpack_upper(from_wire(joined.cov))"),),
    ),
    Bug(
        "hcmci multiplies novelties by the number of nodes",
        "concord.filters.fusion.hybrid_consensus", "from_information",
        (("1.0 / row.max(axis=-1)", "row.shape[-1] + 0 * row[..., 0]"),),
    ),
    Bug(
        "set membership forgets the noise of the plant",
        "concord.features.sets.set_membership", "predict_sets",
        (("step), transition, noise)", "step), transition, 0 * noise)"),),
    ),
    Bug(
        "a guardian blocks nobody",
        "concord.nodes.faults.retries",
        "collides",
        (('if owned and faults.at("guardian", way.step):', "if False:"),),
    ),
    Bug(
        "a channel that loses some frames loses all",
        "concord.nodes.faults.links", "carries",
        (("fails is None or draw >= fails[0]", "fails is None"),),
    ),
    Bug(
        "a clock has run away since the run began",
        "concord.nodes.faults.active", "Faults.clocks",
        (("fault.numbers[0], fault.first_cycle)", "fault.numbers[0], 0)"),),
    ),
    Bug(
        "what a slow node says comes at once",
        "concord.nodes.faults.links", "_late", (("late += int(slow[0])", "late += 0"),),
    ),
    Bug(
        "who hangs never wakes up",
        "concord.nodes.faults.active", "Faults.at",
        (("passed = kind in PASSING and", "passed = kind in PASSING and False and"),),
    ),
    Bug(
        "what was wrong stays so in calm",
        "concord.nodes.changes", "after",
        (("loss=None, losses=(), cuts=(), faults=())", "loss=None, losses=(), cuts=())"),),
    ),
    Bug(
        "a share that was overtaken is lost",
        "concord.nodes.inbox", "let_in_overtaken", (("if fragments:", "if False:"),),
    ),
    Bug(
        "a share of no numbers is read",
        "concord.nodes.vector_codec", "VectorCodec.check",
        (("if not finite:", "if False:"),),
    ),
    Bug(
        "a covariance that is none is used",
        "concord.nodes.rules.belief_consensus", "BeliefConsensus.fuse",
        (("and (unsound := heard & unsound)", "and (unsound := heard & False)"),),
    ),
    Bug(
        "those who agree most are taken for liars",
        "concord.filters.fusion.trimmed",
        "_far_ones",
        (("candidates, -rounded", "candidates, rounded"),),
    ),
    Bug(
        "a neighbour may be as sure as it likes",
        "concord.filters.fusion.trimmed", "_growth", (("share < least", "share < 0 * least"),),
    ),
)  # fmt: skip


# Bugs of time and lives.
LIVES_BUGS = (
    Bug(
        "a node that joins takes an old belief for that of now",
        "concord.nodes.environment_changes", "_joined",
        (("newest.step == state.released - 1", "True"),),
    ),
    Bug(
        "a scripted restart that dies while booting is waited for",
        "concord.runtime.processes.environment.decisions", "EnvironmentDecisions._hear_of_end",
        (("self.done(self.controller.not_started(node))", "[]"),),
    ),
    Bug(
        "a node that is too slow works off every reading",
        "concord.runtime.processes.node.real_time_decisions", "NodeTimetable.is_lost",
        (("self.late_s(now_s, step) > self.tempo.oldest_s", "False"),),
    ),
    Bug(
        "an environment that stood still ends the run at once",
        "concord.runtime.processes.environment.decisions", "EnvironmentDecisions._give_up",
        (("AwaitReturn(_RETURN_S)", "AwaitReturn(0.0)"),),
    ),
    Bug(
        "a node that joins hears of no change after its welcome",
        "concord.nodes.changes", "since_return",
        (("changes[returns[-1] + 1 :]", "()"),),
    ),
    Bug(
        "a forged end of a node is believed for ever",
        "concord.nodes.run_controller", "RunController.take",
        (("isinstance(event, Estimate) and event.absent", "False"),),
    ),
)  # fmt: skip


@contextmanager
def planted(bug: Bug) -> Iterator[None]:
    """While this lasts the bug is in the program, which computes with numpy alone."""
    module = importlib.import_module(bug.module)
    holder, _, name = bug.function.rpartition(".")
    owner = getattr(module, holder) if holder else module
    sound = owner.__dict__[name]
    assert sound.__module__ == bug.module, f"{bug.name}: it stands in {sound.__module__} now"
    text = textwrap.dedent(inspect.getsource(sound))
    for stands, shall in bug.texts:
        assert text.count(stands) == 1, f"{bug.name}: {stands!r} stands there no more"
        text = text.replace(stands, shall)
    made: dict[str, Any] = {}
    exec(compile(text, f"<{bug.name}>", "exec"), module.__dict__, made)
    # The code of the function, as tables and other modules hold the function itself.
    code, sound.__code__ = sound.__code__, made[name].__code__
    try:
        yield
    finally:
        sound.__code__ = code


FOUND = {
    "a share is used in every part of its cycle": 25,
    "a share of the next cycle is used before its time": 5,
    "a late frame is not counted": 8,
    "the cycle counter is not checked": 8,
    "the checksum of a frame that is due is not checked": 8,
    "a frame that is due is that of any cycle": 21,
    "a null frame is read": 11,
    "who is out is still waited for": 11,
    "averaged information weighs twice": 11,
    "who comes back is far too sure of itself": 11,
    "hcmci multiplies novelties by the number of nodes": 4,
    "a guardian blocks nobody": 10,
    "a clock has run away since the run began": 5,
    "who hangs never wakes up": 5,
    "a share that was overtaken is lost": 11,
    "a share of an earlier cycle is not dropped": 68,
    "a covariance is not quite symmetric": 26,
    "a channel that loses some frames loses all": 61,
    "what a slow node says comes at once": 15,
    "a share of no numbers is read": 30,
    "a covariance that is none is used": 43,
    "those who agree most are taken for liars": 64,
    "a neighbour may be as sure as it likes": 64,
    "a node that joins takes an old belief for that of now": 2,
    "a scripted restart that dies while booting is waited for": 11,
    "an environment that stood still ends the run at once": 2,
    "a node that joins hears of no change after its welcome": 17,
    "a forged end of a node is believed for ever": 31,
}
"""Seeds that found a bug which few of the first seeds find."""


class Outcome(Protocol):
    """Result of the case of a seed."""

    @property
    def seed(self) -> int: ...
    @property
    def broken(self) -> str | None: ...
    @property
    def seen(self) -> str | None: ...


def run_seed(seed: int) -> Outcome:
    """Run the drawn case of a seed."""
    return run_case(draw_case(seed, {}))


def run_life(seed: int) -> Outcome:
    """Run the case of time and lives of a seed."""
    return run_lives(draw_lives(seed))


def first_found(
    bug: Bug, seeds: Iterable[int], run: Callable[[int], Outcome] = run_seed
) -> Outcome | None:
    """Return the outcome of the first seed that finds a bug."""
    with planted(bug):
        for seed in seeds:
            outcome = run(seed)
            if outcome.broken:
                return outcome
    return None


def bugs() -> None:
    """Plant each bug, and print the first seed that finds it; try the sound cases.

    The exit code is 1 where no seed finds a bug, or where a sound case is complained of.
    """
    missed = 0
    for case in SOUND:
        broken = run_case(draw_case(case.seed, case.fixed)).broken
        missed += broken is not None
        sys.stdout.write(f"seed {case.seed}: {broken or 'sound'}\n")
    kinds = ((BUGS, MOST_SEEDS, run_seed), (LIVES_BUGS, MOST_LIVES, run_life))
    for several, most, run in kinds:
        for bug in several:
            found = first_found(bug, range(1, most + 1), run)
            missed += found is None
            what = f"seed {found.seed}: {found.broken}: {found.seen}" if found else "NOT FOUND"
            sys.stdout.write(f"{bug.name}: {what}\n")
            sys.stdout.flush()
    sys.exit(1 if missed else 0)
