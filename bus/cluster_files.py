"""Clusters as TOML files, for people: one line per parameter, with its name in the standard."""

import json
import tomllib

import msgspec

from bus.cluster import Cluster, ClusterError
from bus.constraints import PARAMETERS

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
