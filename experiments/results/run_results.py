"""Results of a run from what it recorded: the trace, and the arrays and the capture made of it."""

from pathlib import Path

from concord.bus.recordings.pcap import FLEXRAY_LINK, write_pcap
from concord.experiments.results.bus_capture import capture
from concord.experiments.results.folder import CAPTURE, RECORDING, Description, write_arrays
from concord.experiments.results.trace import Trace, read_trace
from concord.runtime.disk import writing
from concord.runtime.recording import read_recording
from concord.scenarios.bus_plan import frame_format


def completed(folder: Path, description: Description) -> Trace:
    """Return the trace of the steps that all nodes completed.

    Raises:
        ValueError: there are none.
    """
    recording = folder / RECORDING
    if not recording.exists():
        raise ValueError(f"{recording}: there is none; the run ended before it began to record")
    trace = read_trace(description.setup, read_recording(recording))
    if not trace.steps:
        raise ValueError(f"{recording}: the run ended before all nodes completed a step")
    return trace


def write_results(folder: Path, description: Description, trace: Trace) -> None:
    """Write run.nc, and bus.pcap where the bus has frames."""
    write_arrays(folder, description, trace)
    frames = capture(description.setup, trace, read_recording(folder / RECORDING))
    if frames is not None:
        with writing(folder / CAPTURE):
            link = frame_format(description.setup.scenario).link or FLEXRAY_LINK
            write_pcap(folder / CAPTURE, frames, link)
