"""A FlexRay cluster whose parameters have been checked against the specification."""

import msgspec

from concord.bus.flexray.cluster_parameters import ClusterParameters
from concord.bus.flexray.constraints import macrotick_violations, range_violations, violations


class ClusterError(ValueError):
    """A cluster that breaks a range or a constraint of the FlexRay specification."""


class Cluster(ClusterParameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One FlexRay cluster. Its macrotick is the cycle over the macroticks of a cycle, whatever
    digits were printed.

    Raises `ClusterError` that names every broken rule and its cure.
    """

    def __post_init__(self) -> None:
        broken = range_violations(self)
        if not broken:
            misprint = macrotick_violations(self)
            macrotick_us = self.cycle_us / self.macroticks_per_cycle
            msgspec.structs.force_setattr(self, "macrotick_us", macrotick_us)
            broken = (*misprint, *violations(self))
        if broken:
            raise ClusterError(f"cluster {self.name!r}: " + "; ".join(broken))
