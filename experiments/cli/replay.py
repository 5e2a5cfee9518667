"""`concord replay`: a recorded run in the browser."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from concord.experiments.monte_carlo.other_runs import OtherRuns
from concord.experiments.page_options import PageOptions, check_place
from concord.experiments.results.folder import RECORDING, read_description
from concord.experiments.user_errors import user_errors


def replay(
    recording: tyro.conf.Positional[Path],
    options: Annotated[PageOptions, tyro.conf.arg(name="")],
) -> None:
    """Show a recorded run in the browser: its run.mcap or its folder."""
    from concord.dashboard.serve import open_recording

    with user_errors():
        check_place(options.host, options.http_port)
        if not recording.exists():
            raise ValueError(
                f"{recording}: there is none; name the run.mcap of a run, or its folder"
            )
        folder = recording if recording.is_dir() else recording.parent
        description = read_description(folder)
        file = folder / RECORDING if recording.is_dir() else recording
        if not file.is_file():
            raise ValueError(f"{file}: there is none; the run ended before it began to record")
        others = OtherRuns(description.setup, sparing=False)
        page = open_recording(
            description.setup, file, options.host, options.http_port, options.light, others
        )
    sys.stderr.write(f"{page.url}  (Ctrl-C ends)\n")
    try:
        with user_errors():
            page.run(lambda: False)
    finally:
        others.close()
        page.close()
