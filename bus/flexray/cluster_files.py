"""Cluster files: FIBEX, or TOML for people, a line per parameter with its name in the standard."""

import json
import tomllib
from pathlib import Path

import msgspec

from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.bus.flexray.constraints import PARAMETERS
from concord.bus.flexray.fibex import cluster_from_fibex

FILE_ENDINGS = (".toml", ".xml")

_OTHER_NAMES = {
    "channels": "pChannels",
    "bit_rate_mbps": "1 / gdBit, Mbit/s",
    "microtick_us": "pdMicrotick",
}


def cluster_to_toml(cluster: Cluster) -> str:
    """The TOML text of a cluster."""
    lines: list[str] = []
    for field, value in msgspec.structs.asdict(cluster).items():
        # A JSON string without escapes of its own is a TOML string; names are printable text.
        text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
        standard = PARAMETERS[field].standard_name if field in PARAMETERS else ""
        comment = standard or _OTHER_NAMES.get(field, "")
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
        raise ClusterError(f"the cluster file is not valid: {error}") from error


def read_cluster_file(path: Path, name: str | None = None) -> Cluster:
    """The cluster in a file whose ending is one of `FILE_ENDINGS`; in FIBEX the one called `name`.

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
        if path.suffix == ".xml":
            return cluster_from_fibex(data, name)
        return cluster_from_toml(data.decode(errors="replace"))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
