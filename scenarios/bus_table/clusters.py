"""FlexRay clusters by the names that --cluster accepts."""

from pathlib import Path

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.presets import PRESETS, preset
from concord.topology.names import unknown_name

FITTED = "fitted"
# The same with every frame on both channels.
REDUNDANT = "fitted-ab"


def cluster_names() -> tuple[str, ...]:
    """Return the names that --cluster accepts beside files."""
    return (FITTED, REDUNDANT, *PRESETS)


def named_cluster(name: str) -> Cluster:
    """Return the cluster of a preset or a file.

    Raises:
        ValueError: there is no such preset, or the file cannot be read.
    """
    return _read(name)[0]


def cluster_notes(name: str) -> tuple[str, ...]:
    """Return a line for each value that the file of a cluster leaves open; none without a file."""
    return () if name in (FITTED, REDUNDANT) else _read(name)[1]


def _read(name: str) -> tuple[Cluster, tuple[str, ...]]:
    if name in PRESETS:
        return preset(name), ()
    # Only here: most networks have a fitted cluster or a preset.
    from concord.bus.flexray.cluster_files import cluster_with_notes, file_endings

    path = Path(name)
    if path.suffix not in file_endings():
        files = [f"FILE{ending}" for ending in file_endings()]
        raise unknown_name("cluster", name, (*cluster_names(), *files))
    return cluster_with_notes(path)
