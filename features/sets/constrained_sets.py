"""Constrained zonotopes as a receiver of a measurement bus keeps them."""

from dataclasses import dataclass

import numpy as np

from concord.features.sets.filters import zonotope
from concord.features.sets.filters.constrained_zonotope import ConstrainedZonotope, around
from concord.features.sets.filters.zonotope import Zonotope
from concord.features.sets.set_shapes import Zonotopes
from concord.filters.gaussian import Gaussian


@dataclass(frozen=True)
class ConstrainedZonotopes:
    """Sets of `states` dimensions, without lanes.

    The interface is `concord.features.sets.set_receivers.KeptShape`.
    """

    states: int

    def containing(self, prior: Gaussian) -> ConstrainedZonotope:
        """The box around the ellipsoid along its own axes."""
        return around(Zonotopes(self.states).containing(prior))

    def bounds(self, own: ConstrainedZonotope) -> Gaussian:
        """The smaller of two ellipsoids: around the box, and around the set without constraints."""
        n, shape = self.states, Zonotopes(self.states)
        loose = Zonotope(own.lifted.centre[:n], own.lifted.generators[:n])
        found = shape.bounds(own.box), shape.bounds(loose)
        widths = zonotope.half_widths(own.box)
        units = np.where(widths == 0.0, 1.0, widths)
        sizes = [(np.diagonal(one.cov) / units**2).sum() for one in found]
        return found[int(sizes[1] < sizes[0])]

    def generators_of(self, own: ConstrainedZonotope) -> None:
        """Return None: its generators alone do not tell it."""
