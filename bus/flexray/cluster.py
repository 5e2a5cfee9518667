"""A FlexRay cluster whose parameters have been checked against the specification."""

from concord.bus.flexray.cluster_parameters import ClusterParameters
from concord.bus.flexray.constraints import violations


class ClusterError(ValueError):
    """A cluster that breaks a range or a constraint of the FlexRay specification."""


class Cluster(ClusterParameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One FlexRay cluster. Raises `ClusterError` that names every broken rule and its cure."""

    def __post_init__(self) -> None:
        broken = violations(self)
        if broken:
            raise ClusterError(f"cluster {self.name!r}: " + "; ".join(broken))
