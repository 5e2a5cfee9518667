"""Results of a run from what it recorded: the trace, and the arrays and the capture made of it."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from concord.bus.pcap import FLEXRAY_LINK, write_pcap
from concord.disk import writing
from concord.results.bus.bus_capture import capture, check_all_cycles, traffic_of
from concord.results.bus.node_capture import node_capture
from concord.results.folder import NODE_CAPTURE, Description, recording_of, write_whole
from concord.results.records.netcdf_file import CAPTURE, RECORDING
from concord.results.records.runs import Runs
from concord.results.records.runs_file import runs_arrays
from concord.results.records.trace import Trace, read_trace
from concord.runtime.recording import MESSAGE_BYTES, read_recording
from concord.scenarios.build import build_bus
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.innovations import HearsAll
from concord.scenarios.moves import with_moves
from concord.scenarios.scenario import require
from concord.scenarios.setup import Setup

_TOLD_EVERY_BYTES = 1 << 20


class Captures(NamedTuple):
    """Captures that a run leaves: whether bus.pcap has the cycles between the steps, and nodes that
    get one of their own."""

    all_cycles: bool = False
    nodes: tuple[int, ...] = ()


NO_MORE = Captures()


def check_captures(setup: Setup, captures: Captures) -> None:
    """Refuse captures that a run cannot have.

    Raises:
        ValueError: naming the option, its value and the cure.
    """
    if captures.all_cycles:
        check_all_cycles(setup)
    if captures.nodes and not build_bus(setup).has_time:
        raise ValueError(
            f"--capture-nodes {captures.nodes[0]}: a bus without time has no capture; use --bus "
            "flexray, or leave it out"
        )
    last = setup.scenario.nodes - 1
    for node in captures.nodes:
        require(0 <= node <= last, "capture-nodes", node, f"a node of the network, 0 to {last}")


def completed(
    folder: Path, description: Description, on_bytes: Callable[[int], None] = lambda _: None
) -> Trace:
    """Return the trace of the steps that all nodes completed.

    Args:
        folder, description: of the run.
        on_bytes: told the bytes of messages of the recording that are read.

    Raises:
        ValueError: there are none.
    """
    recording = recording_of(folder)
    trace = read_trace(description.setup, _counted(read_recording(recording), on_bytes))
    if not trace.steps:
        raise ValueError(f"{recording}: the run ended before all nodes completed a step")
    return trace


def _counted(
    messages: Iterable[tuple[str, bytes]], on_bytes: Callable[[int], None]
) -> Iterator[tuple[str, bytes]]:
    read_bytes = told_bytes = 0
    for topic, data in messages:
        read_bytes += MESSAGE_BYTES + len(data)
        if read_bytes - told_bytes >= _TOLD_EVERY_BYTES:
            told_bytes = read_bytes
            on_bytes(read_bytes)
        yield topic, data


def as_it_ran(description: Description, trace: Trace) -> Description:
    """Return the description whose sensors stand in each step where they stood in the run."""
    setup = with_moves(description.setup, trace.history.moves)
    return msgspec.structs.replace(description, setup=setup)


def write_results(
    folder: Path,
    description: Description,
    trace: Trace,
    runs: Runs,
    captures: Captures = NO_MORE,
    heard: HearsAll | None = None,
) -> None:
    """Write run.nc, and where the bus has time bus.pcap and a capture for each node of these.

    Args:
        folder, description: where to, and of what.
        trace: what the recording says. runs: the record that is made of it.
        captures: which captures.
        heard: the filter that hears everything, where sensors have filters.
    """
    write_whole(folder, runs_arrays(runs, heard=heard), description)
    setup, recording = description.setup, folder / RECORDING
    frames = capture(setup, trace, read_recording(recording), captures.all_cycles)
    if frames is None:
        return
    link = frame_format(setup.scenario).link or FLEXRAY_LINK
    with writing(folder / CAPTURE):
        write_pcap(folder / CAPTURE, frames, link)
    traffic = traffic_of(setup, trace, read_recording(recording)) if captures.nodes else None
    if traffic is None:
        return
    for node in captures.nodes:
        path = folder / NODE_CAPTURE.format(node)
        with writing(path):
            write_pcap(path, node_capture(setup, traffic, node), link)
