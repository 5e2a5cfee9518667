"""Opens a page on a recording or on a network that runs."""

from pathlib import Path

from concord.dashboard.app import Dashboard
from concord.dashboard.comparison.other_run import OtherRun, RatioInterval, refuse_unlike
from concord.dashboard.frames.expected import Expectation, nothing_expected
from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.frames.source import RecordedSource
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.theme import DARK, LIGHT
from concord.runtime.recording import read_recording
from concord.scenarios.setup import Setup


def open_recording(
    setup: Setup,
    recording: Path,
    host: str,
    port: int,
    light: bool,
    expected: Expectation = nothing_expected,
    other: OtherRun | None = None,
    verdict: str = "",
) -> Dashboard:
    """A page on a recorded run, and on one beside it; `expected` is what more runs tell of it, and
    `verdict` that on the whole run.

    Raises:
        ValueError: the file is not a recording, or an empty one.
    """
    source, theme = _recorded(setup, recording, verdict), LIGHT if light else DARK
    return Dashboard(source, host, port, theme, recording.parent, expected, other)


def _recorded(setup: Setup, recording: Path, verdict: str = "") -> RecordedSource:
    # Its first message tells whether it is one, before a page is opened on it.
    if next(iter(read_recording(recording)), None) is None:
        raise ValueError(
            f"{recording}: nothing was recorded; the run ended before its first message"
        )
    return RecordedSource(set_stage(setup), recording, verdict)


def other_run(
    setup: Setup, recording: Path, beside: Setup, labels: tuple[str, str], ratio: RatioInterval
) -> OtherRun:
    """Return a recorded run to show beside one of setup `beside`; `labels` has that one's first.

    Raises:
        ValueError: the file is no recording, or not of the same truth.
    """
    refuse_unlike(beside, setup, labels)
    return OtherRun(_recorded(setup, recording), labels, ratio)


def open_network(
    source: LiveNetwork,
    folder: Path | None,
    host: str,
    port: int,
    light: bool,
    expected: Expectation = nothing_expected,
) -> Dashboard:
    """A page on a network that runs; `folder` is that of its run, if it is known."""
    return Dashboard(source, host, port, LIGHT if light else DARK, folder, expected)
