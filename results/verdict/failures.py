"""Findings that make the figures of runs meaningless, from what nodes counted and recorded."""

from collections.abc import Iterator, Sequence

import numpy as np

from concord.results.figures.run_view import RunView
from concord.results.innovations.gates import RefusedAtNode
from concord.results.outages import outages_of
from concord.results.verdict.findings import Finding
from concord.scenarios.types.rules import UserRule

_UNUSABLE = ("not-positive-definite", "not-finite", "measurement-infinite")
"""Endings of the reasons for which nodes refuse the values of a sound frame."""


def failures(view: RunView, refused: Sequence[RefusedAtNode] = ()) -> Iterator[Finding]:
    """Yield what failed in runs, first the cause that makes all others meaningless."""
    yield from _truth(view)
    # The filters cannot use beliefs that a rule has spoilt.
    yield from _fusions(view)
    yield from _filters(view)
    yield from _readings(view)
    yield from _gates(refused)
    yield from _members(view)


def _truth(view: RunView) -> Iterator[Finding]:
    first = int(view.finite_steps.min())
    if first < view.runs.steps:
        yield Finding(
            level="FAILED",
            cause="truth not finite",
            said=f"the truth is not finite from step {first} on: the model leaves the numbers",
            cure=f"correct the model, or run no longer than --steps {first}",
            first_step=first,
        )


def _filters(view: RunView) -> Iterator[Finding]:
    updates, moves = (view.counts(f"{name}-failed").sum(axis=0) for name in ("update", "predict"))
    taken = np.logical_not(view.blind).sum(axis=(0, 1))
    for failed, what, cure in (
        (moves, "predictions of its filter failed", "correct the model f or Q: it gave a value "
         "that is not finite, or a covariance that is none"),
        (updates, "readings could not be used by its filter", "correct the sensor's h or R: it "
         "gave a value that is not finite, or a covariance that is none"),
    ):  # fmt: skip
        if failed.any():
            node, count = int(failed.argmax()), int(failed.max())
            of = f" of {int(taken[node])}" if failed is updates else ""
            more = int(np.count_nonzero(failed)) - 1
            others = f", and {more} more node{'s' * (more > 1)}" if more else ""
            yield Finding(
                level="FAILED",
                cause="filter failed",
                said=f"node {node}: {count}{of} {what}{others}",
                cure=cure,
                node=node,
                count=int(failed.sum()),
            )


def _fusions(view: RunView) -> Iterator[Finding]:
    failed = view.counts("fuse-failed").sum(axis=0)
    refused = sum(
        (
            counts.sum(axis=0)
            for name, counts in view.runs.counters.items()
            if name.startswith("rejected") and name.endswith(_UNUSABLE)
        ),
        np.zeros(view.setup.scenario.nodes),
    )
    rule, changed = view.setup.scenario.rule, bool(view.setup.scenario.changes)
    changed |= view.runs.history is not None and view.runs.history.changed
    if failed.any():
        counts, cause, said = failed, "fusion failed", "fusions gave no belief"
    elif refused.any() and not changed:
        counts, cause, said = refused, "values unusable", "shares were refused: they hold no belief"
    else:
        return
    node, count = int(counts.argmax()), int(counts.sum())
    yield Finding(
        level="FAILED",
        cause=cause,
        said=f"rule {rule.name}: {count} {said}, most of them at node {node}",
        cure="correct the rule" if isinstance(rule, UserRule) else "choose another rule: --rule ci",
        node=node,
        count=count,
    )


def _readings(view: RunView) -> Iterator[Finding]:
    if (view.blind.all(axis=2) | np.logical_not(view.counted)).all():
        yield Finding(
            level="FAILED",
            cause="no readings",
            said="no node had a reading in any scored step: the estimates follow the model alone",
            cure="give the sensors a range, a rate or a place at which they read something",
        )


def _gates(refused: Sequence[RefusedAtNode]) -> Iterator[Finding]:
    for one in refused:
        if one.taken and one.refused == one.taken:
            yield Finding(
                level="FAILED",
                cause="readings refused",
                said=f"node {one.node}: its gate refused all {one.taken} readings of its sensor",
                cure="widen the gate, or leave it out; then look at NIS",
                node=one.node,
                count=one.refused,
            )
        elif one.is_locked:
            yield Finding(
                level="CHECK",
                cause="gate locked",
                said=(
                    f"node {one.node}: its gate refused {one.refused} of {one.taken} readings, "
                    f"where {100 * one.expected:.2g} % are expected: its filter does not follow"
                ),
                cure="widen the gate, or raise Q or R",
                node=one.node,
                count=one.refused,
            )


def _members(view: RunView) -> Iterator[Finding]:
    for one in outages_of(view.runs):
        if not one.is_asked:
            until = "to the end" if one.end_step is None else f"to step {one.end_step}"
            yield Finding(
                level="FAILED",
                cause="members lost",
                said=f"{one.nodes_in_words()}: lost from step {one.first_step} {until}, unasked",
                cure="look at the hosts and processes of these nodes, and run again",
                node=one.nodes[0],
                first_step=one.first_step,
                count=len(one.nodes),
            )
