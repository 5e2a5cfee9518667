"""Shared parts of the tests of every paper."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from concord.papers.kit.judging import Claim
from concord.results.figures.intervals import Interval

# Numbers that break a claim: each figure of the evidence takes each of them in turn.
BREAKING = (0.0, 1e-12, 1.0, -1.0, 3.0, 10.0, 1e9, -1e9)


Evidence = TypeVar("Evidence")


def every_claim_can_fail(judge: Callable[[Evidence], Sequence[Claim]], evidence: Evidence) -> None:
    """For each claim some figure of the evidence exists whose change makes another verdict, and so
    do figures whose changes make the claim fail or hold."""
    measured = judge(evidence)
    others: list[set[str]] = [{claim.verdict} for claim in measured]
    for broken in _broken(evidence):
        for verdicts, claim in zip(others, judge(broken), strict=True):
            verdicts.add(claim.verdict)
    for claim, verdicts in zip(measured, others, strict=True):
        assert len(verdicts) > 1, f"no figure changes the verdict of: {claim.says}"
        failed = verdicts & {"does not hold", "contradicts itself"}
        assert failed, f"cannot fail: {claim.says}"


def _broken(value: Any) -> Iterator[Any]:
    """The value with one number of it replaced, or all numbers of a dict or tuple by one."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, Interval):
        yield from (Interval(number, number, number) for number in BREAKING)
    elif isinstance(value, int | float):
        yield from (type(value)(number) for number in BREAKING)
    elif isinstance(value, dict):
        yield from (dict.fromkeys(value, number) for number in _of_one_kind(value.values()))
        for key, part in value.items():
            yield from (value | {key: broken} for broken in _broken(part))
    elif isinstance(value, tuple):
        make = getattr(type(value), "_make", tuple)
        if make is tuple:
            yield from ((number,) * len(value) for number in _of_one_kind(value))
        for place, part in enumerate(value):
            for broken in _broken(part):
                yield make((*value[:place], broken, *value[place + 1 :]))


def _of_one_kind(values: Iterable[Any]) -> Iterator[Any]:
    """Numbers for values that are all figures: each of BREAKING."""
    kinds = {type(value) for value in values}
    if kinds == {Interval}:
        yield from (Interval(number, number, number) for number in BREAKING)
    elif len(kinds) == 1 and kinds <= {int, float}:
        yield from BREAKING
