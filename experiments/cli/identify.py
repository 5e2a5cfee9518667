"""`concord identify`: noise, delays and parameters that explain the readings of a scenario best."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich import box
from rich.table import Table
from tyro.conf import Positional

from concord.experiments.cli.help import FIRST
from concord.experiments.scenario_flags import ScenarioFlags, values_in
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.results.innovations.presentation import short
from concord.results.places import make_folder
from concord.scenarios.scenario_options import scenario_of
from concord.studies.identify.identify import Identification, Judgement, identify
from concord.studies.memory import check_memory
from concord.studies.progress import progress

_PARTS = 1000  # of the work, for progress


@dataclass(frozen=True, kw_only=True)
class SeekOptions:
    """Values to seek, and the file for them."""

    seek: Annotated[str | None, FIRST] = None
    """Names such as R.gps,Q.speed,delay.imu,theta.mass; all R and Q when left out. A name that is
    not there is answered with those that are."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"]), FIRST] = None
    """TOML file that --identified takes; it must not exist."""
    json: bool = False
    """Print one JSON object instead of a table."""


def identify_values(
    name: Positional[str] = "",
    /,
    *,
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    options: Annotated[SeekOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Find the noise, delays and parameters that explain the readings of a scenario best.

    The readings are those of its log, or of its simulated run. Values have the greatest likelihood
    of the innovations of the filter that hears everything.

    Args:
        name: The scenario: a name of `concord list`, or FILE.py:NAME.
    """
    with user_errors():
        given = values_in(scenario)
        if name and "scenario" in given:
            raise ValueError(f"{name} and --scenario {given['scenario']}: name one scenario")
        found = scenario_of(**given, **({"scenario": name} if name else {}))
        check_memory(found)
        if options.out is not None:
            if options.out.exists():
                raise ValueError(f"--out {options.out}: the file exists; choose another name")
            make_folder(options.out.parent, "--out", options.out)
        seek = [one.strip() for one in (options.seek or "").split(",") if one.strip()]
        with progress("identify", _PARTS, as_json=options.json) as on_part:
            result = identify(found, seek, lambda done, most: on_part(_PARTS * done // most))
        if options.out is not None:
            result.write(options.out)
    if options.json:
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
    else:
        console = plain_console()
        console.print(_table(result))
        for line in _lines(result, options.out):
            console.print(line)
    if not result.ended:
        raise KeyboardInterrupt


def _table(result: Identification) -> Table:
    grid = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    grid.add_column("value", no_wrap=True)
    for heading in ("before", "found", "95 %"):
        grid.add_column(heading, justify="right", no_wrap=True)
    for one in result.found:
        found = f"{one.value:.4g}" if one.told else "-"
        grid.add_row(one.name, f"{one.before:.4g}", found, result.interval(one) or "-")
    return grid


def _lines(result: Identification, out: Path | None) -> Iterator[str]:
    """Sentences beside the table."""
    untold = [one.name for one in result.found if not one.told]
    if untold:
        yield f"The log does not tell {', '.join(untold)}; left as before."
    if result.left:
        yield f"Not sought, though declared: {', '.join(result.left)}; --seek takes them."
    if any(one.name.startswith(("R.", "Q.")) for one in result.found):
        yield "R and Q are factors of the standard deviations that the scenario has."
    yield f"before: {_words(result.before)}"
    if result.after is None:
        yield "interrupted: these are the likeliest values so far, and no verdict on them"
    else:
        yield f"after:  {_words(result.after)}"
    if out is not None:
        yield f"{out} has the values; add --identified {out}"


def _words(judgement: Judgement) -> str:
    anees = "" if judgement.anees is None else f", ANEES {short(judgement.anees)}"
    return f"NIS {short(judgement.nis)}{anees}; {judgement.said}"
