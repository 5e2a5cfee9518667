"""`concord keys`: certificates and access control for a network on several hosts."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich.console import Console
from rich.table import Table

from concord.experiments.security_check import IntrusionAttempt, check
from concord.experiments.user_errors import user_errors
from concord.features.hosts.certificates import make_keys


@dataclass(frozen=True)
class KeysOptions:
    """Whom to make keys for."""

    folder: tyro.conf.Positional[Path]
    """A new folder for the keys; with --check, the folder of the keys to be tried."""
    nodes: int | None = None
    """Number of sensor nodes."""
    hosts: tuple[str, ...] = ()
    """Hosts that run a router, by the names or addresses at which others reach them; left out:
    this machine alone."""
    days: int = 90
    """How long the certificates hold."""
    check: bool = False
    """Try to break in with the keys in the folder, on this machine, and show what came of it."""
    json: bool = False
    """Print one JSON object."""


def keys(options: Annotated[KeysOptions, tyro.conf.arg(name="")]) -> None:
    """Make certificates and access control for a network, or try to break in (--check)."""
    if options.nodes is None and not options.check:
        with user_errors():
            raise ValueError("--nodes is missing: say for how many nodes, or --check to try keys")
    if options.nodes is not None:
        with user_errors():
            files = make_keys(options.folder, options.nodes, options.hosts, options.days)
        _show_files(options, files)
    if options.check:
        _check(options)


def _show_files(options: KeysOptions, files: list[str]) -> None:
    made = {"folder": str(options.folder), "days": options.days, "files": files}
    if not options.json:
        where = f"{options.folder}: {len(files)} files, valid for {options.days} days"
        Console().print(where, highlight=False, soft_wrap=True)
    elif not options.check:
        sys.stdout.write(msgspec.json.encode(made).decode() + "\n")


def _check(options: KeysOptions) -> None:
    with user_errors():
        attempts = check(options.folder)
    held = all(attempt.held for attempt in attempts)
    if options.json:
        result = {"held": held, "attempts": attempts}
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
    else:
        _show_attempts(attempts)
    sys.exit(0 if held else 1)


def _show_attempts(attempts: list[IntrusionAttempt]) -> None:
    table = Table("who", "tried", "arrived", "outcome")
    for one in attempts:
        outcome = one.outcome if one.held else f"{one.outcome}: BROKEN, not {one.wanted}"
        table.add_row(one.who, one.tried, f"{one.arrived}/{one.tries}", outcome)
    Console().print(table)
