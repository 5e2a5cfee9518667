"""Promises that the recording of every run keeps, checked against the evidence."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from concord.studies.audit.evidence import MOST_GROUPS, Evidence, floats
from concord.studies.audit.member_history import MemberHistory

# A node that is silent for so long has to be given up: a lease of 2 s, and the time to tell of it.
_SILENCE_S = 10.0
# The environment may be so many steps ahead of an estimate, where no controller closes a loop.
_STEPS_AHEAD = 4


class Run(NamedTuple):
    """The evidence of a run of N nodes and its membership.

    `complete` steps have a truth, and in lockstep an estimate of every member.
    """

    evidence: Evidence
    membership: MemberHistory
    nodes: int
    complete: int
    time_step_s: float


class Account(NamedTuple):
    """How a promise was kept: places checked, places where it is broken, and the first of them.

    `note` counts what breaks no promise.
    """

    checked: int
    broken: int
    first: str = ""
    note: str = ""


class RunPromise(NamedTuple):
    """A promise: a sentence, and the check."""

    says: str
    check: Callable[[Run], Account]


def _account(checked: int, broken: Iterable[str], note: str = "") -> Account:
    cases = list(broken)
    return Account(checked, len(cases), cases[0] if cases else "", note)


def _steps(run: Run) -> Account:
    truths, kept = run.evidence.truths, run.evidence.arrays.sizes["step"]
    counts = {step: len(truths.get(step, ())) for step in range(run.complete)}
    broken = [f"step {step}: {count} truths" for step, count in counts.items() if count != 1]
    if kept != run.complete:
        broken.append(f"run.nc has {kept} steps, the recording {run.complete}")
    return _account(run.complete, broken)


def _of_one_run(run: Run) -> Account:
    """Whether run.json, run.mcap and run.nc tell of one run; a file that says nothing is told."""
    origins = run.evidence.origins
    (first, asked), *others = origins.items()
    broken = [
        f"{name} is {value!r} in {first}, {told.get(name)!r} in {other}"
        for other, told in others
        if told
        for name, value in asked.items()
        if told.get(name) != value
    ]
    silent = [other for other, told in others if not told]
    return _account(len(asked), broken, f"{', '.join(silent)} names no run" if silent else "")


def _all_steps(run: Run) -> Account:
    """Whether the run went through all steps of its scenario."""
    asked = run.evidence.scenario.steps
    if run.evidence.in_real_time or run.complete == asked:
        return Account(asked, 0)
    return Account(asked, 1, f"{run.complete} of {asked} steps")


def _members(run: Run) -> Iterator[tuple[int, int]]:
    for step, node in np.ndindex(run.complete, run.nodes):
        if run.membership.is_in(node, step):
            yield step, node


def _estimates(run: Run) -> Account:
    """Whether each member has an estimate in each step; words lost with a process are counted."""
    wanted = list(_members(run))
    missing = [place for place in wanted if place not in run.evidence.estimates]
    lost = [place for place in missing if _died_then(run, *place)]
    if run.evidence.in_real_time:
        return _silences(run, len(wanted), missing)
    cases = (f"step {step}: none of node {node}" for step, node in sorted(set(missing) - set(lost)))
    return _account(len(wanted), cases, f"{len(lost)} lost with their process" if lost else "")


def _died_then(run: Run, step: int, node: int) -> bool:
    """Whether a node gave no estimate from a step on until it was out."""
    end = run.membership.left_at(node, step)
    return end is not None and not any(
        (later, node) in run.evidence.estimates for later in range(step, end)
    )


def _is_lost(run: Run, step: int, sender: int) -> bool:
    """Whether a share that was sent in a step may have ended with its process.

    In real time the network says late that a node is out, from a step that is over.
    """
    member = run.membership
    is_over = run.evidence.in_real_time and not member.is_in(sender, step)
    return is_over or member.dies_in(sender, step) or _died_then(run, step, sender)


def _silences(run: Run, wanted: int, missing: list[tuple[int, int]]) -> Account:
    """In real time a late estimate is lost; a node may not stay silent as a member."""
    longest, length = {}, dict.fromkeys(range(run.nodes), 0)
    gaps = set(missing)
    for step, node in np.ndindex(run.complete, run.nodes):
        length[node] = length[node] + 1 if (step, node) in gaps else 0
        if length[node] * run.time_step_s > _SILENCE_S:
            longest[node] = f"node {node} was silent until step {step}, {length[node]} steps"
    return _account(wanted, longest.values(), f"{len(missing)} missing" if missing else "")


def _estimate_ages(run: Run) -> Account:
    """Whether each estimate in real time says how old it was when it was sent, and was no older
    than the timetable allows; in lockstep no estimate has an age."""
    said = run.evidence
    shown = said.arrays.get("estimate_age_s")
    limit_s = np.inf if shown is None else float(shown.attrs.get("limit", np.inf))
    ages = {place: one.age_s for place, all_of in said.estimates.items() for one in all_of}
    known = [age_s for age_s in ages.values() if age_s is not None]
    broken = [
        f"step {step}: that of node {node} "
        + ("says no age" if age_s is None else f"is {age_s:.3g} s old; allowed are {limit_s:.3g} s")
        for (step, node), age_s in sorted(ages.items())
        if (age_s is None) == said.in_real_time or not 0 <= (age_s or 0.0) <= limit_s
    ]
    note = f"oldest {max(known):.3g} s, limit {limit_s:.3g} s" if known else ""
    return _account(len(ages), broken, note)


def _strangers(run: Run) -> Account:
    """Whether a node that is out says nothing.

    A process may die amid the step from which its node is out, or in which it joins. A node that
    hangs, and any node in real time, speaks on until it hears that it was given up; these words are
    counted.
    """
    said, member = run.evidence, run.membership
    words = [
        (step, node, f"step {step}: estimate of node {node}")
        for step, node in sorted(said.estimates)
        if not member.is_in(node, step)
    ]
    for cycle, node in sorted(said.frames):
        step = member.step_of(cycle)
        if not (member.is_in(node, step) or member.dies_in(node, step)):
            words.append((step, node, f"cycle {cycle}: frame of node {node}"))
    broken = [
        text for step, node, text in words if not (said.in_real_time or member.hangs_in(node, step))
    ]
    counted = len(words) - len(broken)
    note = f"{counted} words of nodes that were out" if counted else ""
    return _account(len(said.estimates) + len(said.frames), broken, note)


def _once(run: Run) -> Account:
    said = run.evidence
    records = {"estimate": said.estimates, "heartbeat": said.heartbeats}
    twice = [
        f"step {step}: {len(all_of)} times the {what} of node {node}"
        for what, kept in records.items()
        for (step, node), all_of in sorted(kept.items())
        if len(all_of) > 1
    ]
    twice += [
        f"cycle {cycle}: a frame of node {node} {max(frames.values())} times"
        for (cycle, node), frames in sorted(said.frames.items())
        if max(frames.values()) > 1
    ]
    return _account(len(said.estimates) + len(said.heartbeats) + len(said.frames), twice)


def _arrays(run: Run) -> Account:
    """Whether run.nc holds the recorded estimates, to the bit, and none beside them."""
    mean, cov = run.evidence.arrays["mean"].values, run.evidence.arrays["cov"].values
    upper = np.triu_indices(mean.shape[-1])
    steps = min(run.complete, len(mean))
    broken = []
    for step, node in np.ndindex(steps, run.nodes):
        in_time = run.membership.is_in(node, step)
        said = run.evidence.estimates.get((step, node)) if in_time else None
        shown = mean[step, node], cov[step, node][upper]
        if said is None:
            same = all(np.isnan(values).all() for values in shown)
        else:
            same = _same_angles(shown[0], said[0].mean) and np.array_equal(
                shown[1], said[0].cov, equal_nan=True
            )
        if not same:
            broken.append(f"step {step}, node {node}")
    return _account(steps * run.nodes, broken)


def _same_angles(shown: np.ndarray, said: np.ndarray) -> bool:
    """Whether means are equal to the bit, or those of angles whole turns apart."""
    if np.array_equal(shown, said, equal_nan=True):
        return True
    return bool(np.array_equal(shown, said + 2 * np.pi * np.round((shown - said) / (2 * np.pi))))


def _published(run: Run) -> Account:
    arrays = run.evidence.arrays
    published = arrays["payload_bytes"].values > 0
    if "cut" in arrays:
        published &= arrays["cut"].values == 0
    broken = []
    for step in range(min(run.complete, len(published))):
        for place, cycle in enumerate(run.membership.cycles_of(step)):
            sent = [(cycle, node) in run.evidence.frames for node in range(run.nodes)]
            if sent != published[step, place].tolist():
                broken.append(f"cycle {cycle} of step {step}")
    return _account(run.complete, broken)


def _ages(run: Run) -> Account:
    """Whether each share that a node holds was sent in the cycle that its age names."""
    arrays = run.evidence.arrays
    ages, receivers, senders = (arrays[name].values for name in ("ages", "receiver", "sender"))
    checked, broken, lost = 0, [], 0
    for step, link in np.argwhere(ages >= 0).tolist():
        node, sender = int(receivers[link]), int(senders[link])
        checked += 1
        cycle = run.membership.cycles_of(step)[-1] - int(ages[step, link])
        if (cycle, sender) in run.evidence.frames:
            continue
        if cycle >= 0 and _is_lost(run, run.membership.step_of(cycle), sender):
            lost += 1
            continue
        broken.append(f"step {step}: node {node} holds a share of node {sender}, cycle {cycle}")
    return _account(checked, broken, f"{lost} lost with their sender" if lost else "")


def _counters(run: Run) -> Account:
    """Whether totals never fall within a life of a node."""
    broken, checked = [], 0
    before: dict[int, dict[str, int]] = {}
    returns = {(turn.step, turn.node) for turns in run.membership.turns.values() for turn in turns}
    for step, node in np.ndindex(run.complete, run.nodes):
        if (step, node) in returns:
            before.pop(node, None)
        for said in run.evidence.estimates.get((step, node), ())[:1]:
            checked += 1
            fallen = [k for k, v in before.get(node, {}).items() if said.counters.get(k, 0) < v]
            broken += [f"step {step}: {name} of node {node} fell" for name in fallen]
            before[node] = said.counters
    return _account(checked, broken)


def _told(run: Run) -> Account:
    """Whether all members heard in a step of the changes that happened in it.

    A node that joins is welcomed with the state of the network. Of a death all hear on a topic of
    its own, and by the heartbeats after it. Of a node that dies in the step of its return they need
    not hear that it is back. Where it returns again before that step, they hear of one return.
    """
    happened: dict[int, list[dict[str, Any]]] = {}
    for step, change in run.evidence.events:
        before = happened.get(step, [])
        if change["what"] == "joined":
            before = [one for one in before if not _is_return_of(change["node"], one)]
        happened[step] = [*before, change]
    broken = []
    for (step, node), (told, *_) in sorted(run.evidence.heartbeats.items()):
        joins = run.membership.joins_at(node, step)
        heard, real = (_lasting(run, step, all_of) for all_of in (told, happened.get(step, [])))
        if not joins and heard != real:
            broken.append(f"step {step}: node {node}")
    return _account(len(run.evidence.heartbeats), broken)


def _is_return_of(node: int, change: dict[str, Any]) -> bool:
    return change["what"] == "joined" and change["node"] == node


def _lasting(run: Run, step: int, changes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the changes of a step without deaths, and returns that end in it.

    How fast the network goes concerns the environment alone.
    """
    return [
        change
        for change in changes
        if change["what"] not in ("pace", "gone")
        and not (change["what"] == "joined" and not run.membership.is_in(change["node"], step))
    ]


def _agreed(run: Run) -> Account:
    """Whether no member takes another for out that takes part.

    A node may hear of an end in an earlier step than the first that lacks an estimate. In real time
    messages are lost: shorter mistakes are counted.
    """
    said, checked = run.evidence, 0
    mistakes: dict[tuple[int, int], list[int]] = {}
    for (step, node), (estimate, *_) in sorted(said.estimates.items()):
        checked += 1
        for other in estimate.absent:
            steps = range(step, step + _STEPS_AHEAD + 1)
            if all(run.membership.is_in(other, one) for one in steps):
                mistakes.setdefault((node, other), []).append(step)
    broken = [
        f"step {steps[0]}: node {node} takes node {other} for out, in {len(steps)} steps"
        for (node, other), steps in mistakes.items()
        if not said.in_real_time or len(steps) * run.time_step_s > _SILENCE_S
    ]
    short = len(mistakes) - len(broken)
    return _account(checked, broken, f"{short} short mistakes" if short else "")


def _turns(run: Run) -> Account:
    turns = sum(map(len, run.membership.turns.values()))
    broken = [
        f"step {turn.step}: node {turn.node} {'joins' if turn.is_in else 'leaves'} twice"
        for turn in run.membership.repeated
    ]
    told = set(run.evidence.given_up)
    out = {t.node for all_of in run.membership.turns.values() for t in all_of if not t.is_in}
    dead = {change["node"] for _, change in run.evidence.events if change["what"] == "gone"}
    broken += [f"`gone` to all names node {node}, and no event does" for node in sorted(told - out)]
    broken += [
        f"an event calls node {node} gone, and no `gone` to all does"
        for node in sorted(dead - told)
    ]
    return _account(turns, broken)


def _joins(run: Run) -> Account:
    """Whether who joins begins with an estimate that a node had, to the bit.

    In real time the recorder may have lost that estimate.
    """
    checked, lost, broken = 0, 0, []
    for step, change in run.evidence.events:
        if change["what"] != "joined" or change.get("mean") is None:
            continue
        checked += 1
        if source_of(run, step, change) is not None:
            continue
        if run.evidence.in_real_time and _lacks_estimates(run, _believed_in(step, change)):
            lost += 1
        else:
            broken.append(f"step {step}: belief of node {change['node']} is no node's estimate")
    return _account(checked, broken, f"{lost} estimates not recorded" if lost else "")


def _lacks_estimates(run: Run, step: int) -> bool:
    """Whether an estimate of a member of a step is not in the recording."""
    members = (node for node in range(run.nodes) if run.membership.is_in(node, step))
    return any((step, node) not in run.evidence.estimates for node in members)


def _believed_in(step: int, joined: dict[str, Any]) -> int:
    """Return the step of the belief with which a node joins in a step."""
    return step - 1 if joined.get("step") is None else joined["step"]


def source_of(run: Run, step: int, joined: dict[str, Any]) -> int | None:
    """Return the node whose estimate a joining node takes; None if it is no node's."""
    of = _believed_in(step, joined)
    mean, cov = floats(joined["mean"]), floats(joined["cov"])
    for node in range(run.nodes):
        for said in run.evidence.estimates.get((of, node), ()):
            if np.array_equal(said.mean, mean, equal_nan=True) and np.array_equal(
                said.cov, cov, equal_nan=True
            ):
                return node
    return None


def _readable(run: Run) -> Account:
    return _account(1, run.evidence.unreadable)


def _placed(run: Run) -> Account:
    """Whether the messages of a topic stand in order, each at the time of its step.

    In real time, and where nodes died or hung, the recorder may hear a message late.
    """
    misplaced = run.evidence.misplaced
    if run.evidence.in_real_time or run.evidence.given_up:
        return Account(1, 0, note=f"{len(misplaced)} heard late" if misplaced else "")
    return _account(1, misplaced)


def _heartbeats(run: Run) -> Account:
    """Whether each member got its readings in each step, which run.nc holds to the bit."""
    said, shown = run.evidence, run.evidence.arrays["readings"].values
    broken, missing, checked = [], 0, 0
    for step, node in _members(run):
        checked += 1
        readings = said.readings.get((step, node))
        if readings is None:
            missing += 1
            if not (said.in_real_time or run.membership.left_at(node, step) == step + 1):
                broken.append(f"step {step}: none for node {node}")
        elif (step, node) in said.estimates and step < len(shown):
            same = np.array_equal(shown[step, node], readings, equal_nan=True)
            broken += [] if same else [f"step {step}: other readings of node {node} in run.nc"]
    note = f"{missing} missing" if missing and said.in_real_time else ""
    return _account(checked, broken, note)


def _truths(run: Run) -> Account:
    """Whether run.nc holds the recorded truths, to the bit."""
    shown = run.evidence.arrays["truth"].values
    broken = []
    for step, states in sorted(run.evidence.truths.items()):
        if step < min(run.complete, len(shown)):
            state = states[0][: shown.shape[-1]]
            same = np.array_equal(shown[step], state, equal_nan=True)
            broken += [] if same else [f"step {step}"]
    return _account(min(run.complete, len(shown)), broken)


def _grants(run: Run) -> Account:
    """Whether each contest has one grant, whose winners asked for a slot, and run.nc shows which
    nodes asked; nodes that died may have asked unheard."""
    said, member = run.evidence, run.membership
    broken, contests = [], sorted({key for key, _ in said.bids})
    for key in contests:
        cycle, group = divmod(key, MOST_GROUPS)
        grants, step = said.grants.get((cycle, group), []), member.step_of(cycle)
        if len(grants) != 1 and step < run.complete:
            broken.append(f"step {step}, cycle {cycle}: {len(grants)} grants")
    for (cycle, group), grants in sorted(said.grants.items()):
        step = member.step_of(cycle)
        for node in grants[0]:
            if not any(said.bids.get((cycle * MOST_GROUPS + group, node), ())):
                broken.append(f"step {step}, cycle {cycle}: node {node} won without a bid")
    asked = run.evidence.arrays["asked"].values
    for step in range(min(run.complete, len(asked))):
        for place, cycle in enumerate(member.cycles_of(step)):
            for node in range(run.nodes):
                first = cycle * MOST_GROUPS
                bid = said.bids.get((first, node), ())
                if bool(asked[step, place, node]) != any(bid) and _one_group(said, cycle):
                    broken.append(f"step {step}, cycle {cycle}: bid of node {node}")
    if said.in_real_time or said.given_up:
        return Account(len(contests), 0, note=f"{len(broken)} lost" if broken else "")
    return _account(len(contests) + len(said.grants), broken)


def _one_group(said: Evidence, cycle: int) -> bool:
    return (cycle, 1) not in said.grants


def _totals(run: Run) -> Account:
    """Whether a node counts as many frames as it has sent, and heard no more than its network sent
    since it joined."""
    said, member = run.evidence, run.membership
    broken, checked = [], 0
    sent = {place: sum(frames.values()) for place, frames in said.frames.items()}
    own, all_sent = dict.fromkeys(range(run.nodes), 0), 0
    base, heard_from = dict.fromkeys(range(run.nodes), 0), dict.fromkeys(range(run.nodes), 0)
    for step in range(run.complete):
        for node in range(run.nodes):
            if member.joins_at(node, step):
                base[node], heard_from[node] = own[node], all_sent
        for cycle in member.cycles_of(step):
            for node in range(run.nodes):
                own[node] += sent.get((cycle, node), 0)
                all_sent += sent.get((cycle, node), 0)
        for node in range(run.nodes):
            for estimate in said.estimates.get((step, node), ())[:1]:
                checked += 1
                counted, told = own[node] - base[node], estimate.counters
                if told.get("sent", 0) != counted and member.is_in(node, step):
                    broken.append(
                        f"step {step}: node {node} counts {told.get('sent', 0)} sent, {counted} are"
                        " recorded"
                    )
                elif told.get("heard", 0) > all_sent - heard_from[node]:
                    broken.append(f"step {step}: node {node} heard more than was sent")
    if said.in_real_time or said.given_up:
        return Account(checked, 0, note=f"{len(broken)} differ" if broken else "")
    return _account(checked, broken)


PROMISES = (
    RunPromise("run.json, run.mcap and run.nc are of one run", _of_one_run),
    RunPromise("the run went through all its steps", _all_steps),
    RunPromise("each recorded message can be read", _readable),
    RunPromise("messages stand in order, at their times", _placed),
    RunPromise("each step has one truth, and run.nc has each step", _steps),
    RunPromise("each member has an estimate in each step", _estimates),
    RunPromise("each estimate in real time says its age, in the limit", _estimate_ages),
    RunPromise("a node that is out says nothing", _strangers),
    RunPromise("each message is recorded once", _once),
    RunPromise("each member gets its readings in each step", _heartbeats),
    RunPromise("run.nc holds the recorded truths, to the bit", _truths),
    RunPromise("run.nc holds the recorded estimates, to the bit", _arrays),
    RunPromise("each contest has its bids and one grant", _grants),
    RunPromise("run.nc shows the cycles in which nodes sent", _published),
    RunPromise("each share that a node holds was sent", _ages),
    RunPromise("counters never fall within a life", _counters),
    RunPromise("counters tell the recorded frames", _totals),
    RunPromise("all members hear of the same changes", _told),
    RunPromise("no member takes another member for out", _agreed),
    RunPromise("members leave, and absent nodes join", _turns),
    RunPromise("a node that joins begins with a node's estimate", _joins),
)
