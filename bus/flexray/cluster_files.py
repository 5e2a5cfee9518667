"""Cluster files: TOML for people, a line per parameter with its name in the standard.

The table CLUSTER_FILES (`concord.entries`) adds exchange formats.
"""

import json
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from concord.bus.flexray.clock_constraints import CLOCK_PARAMETERS
from concord.bus.flexray.cluster import PARAMETERS, Cluster, ClusterError
from concord.bus.flexray.cluster_parameters import ClockParameters
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.entries import chosen, entries

_OTHER_NAMES = {
    "channels": "pChannels",
    "bit_rate_mbps": "1 / gdBit, Mbit/s",
    "microtick_us": "pdMicrotick",
    "sync_slots": "pKeySlotId of nodes with pKeySlotUsedForSync",
    "startup_slots": "pKeySlotId of nodes with pKeySlotUsedForStartup",
}


class ClusterFileFormat(NamedTuple):
    """The readers of an exchange format; both take a document and the name of one of its clusters.

    The name may be None where the document has one cluster. A document without the cluster, or with
    several and no name, raises ClusterError.

    Attributes:
        read: returns the cluster, and a line for each value that the document leaves open.
        slots: returns the slot table of the cluster, of slots that nothing has checked.
    """

    read: Callable[[bytes, str | None], tuple[Cluster, tuple[str, ...]]]
    slots: Callable[[bytes, str | None], tuple[MessageSlot, ...]]


def file_endings() -> tuple[str, ...]:
    """Return the endings of cluster files: of TOML, then of each exchange format."""
    return (".toml", *entries("CLUSTER_FILES"))


def cluster_to_toml(cluster: Cluster, chosen: Sequence[str] = ()) -> str:
    """The TOML text of a cluster; parameters that it leaves open are left out, and those that were
    chosen are said to be."""
    lines: list[str] = []
    fields = msgspec.structs.asdict(cluster)
    clocks = ClockParameters.__struct_fields__
    for field in sorted(fields, key=clocks.__contains__):
        value = fields[field]
        if value is None or value == ():
            continue
        # A JSON string without escapes of its own is a TOML string; names are printable text.
        plain = list(value) if isinstance(value, tuple) else value
        text = json.dumps(plain, ensure_ascii=False) if isinstance(plain, str) else repr(plain)
        comment = ", ".join(filter(None, (_standard_name(field), "chosen" * (field in chosen))))
        lines.append(f"{field} = {text}" + (f"  # {comment}" if comment else ""))
    return "\n".join(lines) + "\n"


def cluster_from_toml(text: str) -> Cluster:
    """The cluster that a TOML text describes.

    Raises ClusterError that names the line, the missing or unknown field, or the broken rule.
    """
    try:
        return msgspec.convert(tomllib.loads(text), Cluster)
    except tomllib.TOMLDecodeError as error:
        raise ClusterError(f"the cluster file is not TOML: {error}") from error
    except msgspec.ValidationError as error:
        field = str(error).rpartition("`$.")[2].rstrip("`")
        standard = _standard_name(field)
        cure = f"; {field} is {standard} of the standard, correct its value" if standard else ""
        raise ClusterError(f"the cluster file is not valid: {error}{cure}") from error


def _standard_name(field: str) -> str:
    parameters = PARAMETERS | CLOCK_PARAMETERS
    known = parameters[field].standard_name if field in parameters else ""
    return known or _OTHER_NAMES.get(field, "")


def read_cluster_file(path: Path, name: str | None = None) -> Cluster:
    """The cluster in a file whose ending is one of `file_endings()`; in an exchange format the one
    called `name`.

    Raises:
        ValueError: the file cannot be read, or is no cluster, with its path.
    """
    return cluster_with_notes(path, name)[0]


def cluster_with_notes(path: Path, name: str | None = None) -> tuple[Cluster, tuple[str, ...]]:
    """As `read_cluster_file`, with a line for each value that an exchange file leaves open.

    Raises:
        ValueError: the file cannot be read, or is no cluster, with its path.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(
            f"{path}: cannot be read ({error.strerror}); name the file of a cluster"
        ) from None
    try:
        if path.suffix in entries("CLUSTER_FILES"):
            form: ClusterFileFormat = chosen("CLUSTER_FILES", path.suffix)
            cluster, notes = form.read(data, name)
            return cluster, tuple(f"{path}: {note}" for note in notes)
        return cluster_from_toml(data.decode(errors="replace")), ()
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
