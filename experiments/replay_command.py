"""`concord replay`: a recorded run in the browser."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments.other_runs import OtherRuns
from experiments.results import RECORDING, read_description
from experiments.user_errors import user_errors


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Where the page is, and how it looks."""

    host: str = "127.0.0.1"
    """Address to listen at. There is no password: whoever reaches another one sees the run."""
    http_port: int = 8080
    """Port of the page; the next free one if it is taken."""
    light: bool = False
    """Dark ink on white instead of light on black."""


def replay(
    recording: tyro.conf.Positional[Path],
    options: Annotated[PageOptions, tyro.conf.arg(name="")],
) -> None:
    """Show a recorded run in the browser: its run.mcap or its folder."""
    from dashboard.serve import open_recording

    with user_errors():
        folder = recording if recording.is_dir() else recording.parent
        description = read_description(folder)
        file = folder / RECORDING if recording.is_dir() else recording
        if not file.is_file():
            raise ValueError(f"{file}: there is none; name the run.mcap of a run, or its folder")
        others = OtherRuns(description.setup, sparing=False)
        page = open_recording(
            description.setup, file, options.host, options.http_port, options.light, others
        )
    sys.stderr.write(f"http://{options.host}:{page.port}  (Ctrl-C ends)\n")
    try:
        with user_errors():
            page.run(lambda: False)
    finally:
        others.close()
        page.close()
