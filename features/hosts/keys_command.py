"""`concord keys`: certificates and access control for a network on several hosts."""

import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.hosts.certificates import faults_of_keys, make_keys


@dataclass(frozen=True)
class KeysOptions:
    """Whom to make keys for."""

    folder: tyro.conf.Positional[Path]
    """A new folder for the keys; with --check, the folder of the keys to be checked."""
    nodes: int | None = None
    """Number of sensor nodes."""
    hosts: tuple[str, ...] = ()
    """Hosts that run a router, by the names or addresses at which others reach them; left out:
    this machine alone."""
    days: int = 90
    """How long the certificates hold."""
    check: bool = False
    """Check the files of the folder: authority, dates, keys, and who may read them."""
    json: bool = False
    """Print one JSON object."""


def keys(options: Annotated[KeysOptions, tyro.conf.arg(name="")]) -> None:
    """Make certificates and access control for a network, or check such files (--check)."""
    if options.nodes is None and not options.check:
        with user_errors():
            raise ValueError("--nodes is missing: say for how many nodes, or --check to check keys")
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
        plain_console().print(where, soft_wrap=True)
    elif not options.check:
        sys.stdout.write(msgspec.json.encode(made).decode() + "\n")


def _check(options: KeysOptions) -> None:
    with user_errors():
        faults = faults_of_keys(options.folder, datetime.now(UTC))
    if options.json:
        result = {"sound": not any(faults.values()), "files": faults}
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
    else:
        for name, fault in faults.items():
            sys.stdout.write(f"{name}: {fault or 'ok'}\n")
    sys.exit(1 if any(faults.values()) else 0)
