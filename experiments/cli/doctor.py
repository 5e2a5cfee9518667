"""`concord doctor`: whether this machine can run a network, and what to do where it cannot."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich.console import Console

from concord.experiments.doctor.checks import look
from concord.experiments.doctor.finding import Finding, Verdict
from concord.experiments.user_errors import user_errors

_STYLES = {
    Verdict.OK: "green",
    Verdict.OPTIONAL: "dim",
    Verdict.WARNING: "yellow",
    Verdict.FAILING: "bold red",
}


@dataclass(frozen=True)
class DoctorOptions:
    """Intended use of the machine."""

    nodes: int = 16
    """Number of sensor nodes of the network you have in mind."""
    data: tuple[Path, ...] = ()
    """Folders of recorded data to be looked at."""
    json: bool = False
    """Print one JSON object."""


def doctor(options: Annotated[DoctorOptions, tyro.conf.arg(name="")]) -> None:
    """Look whether this machine can run a network; exit code 1 if something is failing."""
    with user_errors():
        if options.nodes < 1:
            raise ValueError(f"--nodes {options.nodes}: a network has at least one node")
    findings = []
    for finding in look(options.nodes, options.data):
        findings.append(finding)
        if not options.json:
            _show(finding)
    healthy = all(finding.verdict is not Verdict.FAILING for finding in findings)
    if options.json:
        result = {"healthy": healthy, "findings": findings}
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
    sys.exit(0 if healthy else 1)


def _show(finding: Finding) -> None:
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{finding.verdict.value:8}", style=_STYLES[finding.verdict], end="")
    console.print(f"{finding.subject}: {finding.seen}", markup=False)
    if finding.cure:
        console.print(f"        -> {finding.cure}", markup=False)
