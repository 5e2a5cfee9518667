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
    if name in PRESETS:
        return preset(name)
    # Only here: most networks have a fitted cluster or a preset.
    from concord.bus.flexray.cluster_files import file_endings, read_cluster_file

    path = Path(name)
    if path.suffix not in file_endings():
        files = [f"FILE{ending}" for ending in file_endings()]
        raise unknown_name("cluster", name, (*cluster_names(), *files))
    return read_cluster_file(path)
