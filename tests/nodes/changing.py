"""Runs of small scenarios in this process, with a script of changes."""

from functools import partial
from typing import Any

import numpy as np

from concord.nodes.commands import Scripted, in_words
from concord.results.records.trace import Trace, read_trace
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import complete_settings
from concord.scenarios.setup import Setup


def script(*lines: str) -> list[Scripted]:
    """From lines such as "10 kill 3"."""
    return [Scripted(int(line.split()[0]), in_words(line.split()[1:])) for line in lines]  # type: ignore[arg-type]


def messages(
    setup: Setup,
    *lines: str,
    link: in_process.Link = in_process.lossless,
    pick: in_process.Pick = in_process.first_come,
    watch: in_process.Watch = in_process.unwatched,
) -> list[tuple[str, bytes]]:
    """The messages of a run in which this happens."""
    recorder = MemoryRecorder()
    nodes = [build_node(setup, node) for node in range(setup.scenario.nodes)]
    environment, told = build_environment(setup), script(*lines)
    check = partial(complete_settings, setup)
    in_process.run(
        environment, nodes, recorder, link=link, pick=pick, watch=watch, script=told, check=check
    )
    return recorder.messages


def run(setup: Setup, *lines: str, **options: Any) -> Trace:
    """The trace of a run in which this happens; options are those of `messages`."""
    return read_trace(setup, messages(setup, *lines, **options))


def same_bits(one: Trace, other: Trace) -> bool:
    """Whether all estimates and ages are equal, bit for bit."""
    return (
        one.mean.tobytes() == other.mean.tobytes()
        and one.cov.tobytes() == other.cov.tobytes()
        and np.array_equal(one.ages, other.ages)
    )
