"""`concord agree`: run one scenario in every driver and compare.

Drivers that pass messages must agree bit for bit, the batched one to 1e-10 of the scale.
"""

import sys
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import msgspec
import tyro

from concord.experiments.scenario_flags import ScenarioFlags, resolved
from concord.experiments.user_errors import user_errors
from concord.results.folder import BATCHED
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.agree import Agreement, agreement
from concord.studies.near_agreement import tolerance_of
from concord.studies.progress import progress


@dataclass(frozen=True)
class AgreeOptions:
    """How to show it."""

    json: bool = False
    """Print one JSON object."""


def agree(
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    output: Annotated[AgreeOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Run a scenario in every driver; exit code 1 if they do not agree."""
    with user_errors():
        setup = prepare(resolved(scenario))
    found = agreement(setup, partial(progress, as_json=output.json))
    _show(setup, found, output.json)
    sys.exit(1 if found.differences else 0)


def _show(setup: Setup, found: Agreement, as_json: bool) -> None:
    scenario, (drivers, near, differences) = setup.scenario, found
    if as_json:
        result = {
            "scenario": scenario,
            "drivers": drivers + [BATCHED] * near,
            "differences": differences,
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    what = (
        f"{scenario.name}, {scenario.nodes} nodes, {scenario.network.graph}, {scenario.steps} steps"
    )
    if not differences:
        also = f"; {BATCHED} to {tolerance_of(setup):g}" if near else ""
        sys.stdout.write(f"{what}: {' = '.join(drivers)}, bit for bit{also}\n")
    for d in differences:
        sys.stdout.write(
            f"{what}: {d.driver} differs from {drivers[0]} first in {d.quantity} at index "
            f"{tuple(d.index)} (step first): {d.value!r} instead of {d.reference!r}\n"
        )
