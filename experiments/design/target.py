"""Target and cost of a design, in a user's words."""

import math
import re
from typing import Literal

import msgspec
import numpy as np

from concord.experiments.monte_carlo.intervals import Interval, ratio_t
from concord.topology.names import unknown_name

Reference = Literal["centralised", "bound", "unit"]
_FORM = re.compile(r"^([0-9.eE+-]+)(?:x-([a-z-]+))?$")
_REFERENCES = ("centralised", "bound")


class DesignTarget(msgspec.Struct, frozen=True):
    """The error to be met: so many times that of a reference, or `unit`s of the scenario."""

    most: float
    reference: Reference

    def shown(self, unit: str) -> str:
        """Return the target in words."""
        if self.reference == "unit":
            return f"RMSE of at most {self.most:g} {unit}"
        name = {"centralised": "the centralised filter's", "bound": "the Cramér-Rao bound"}
        return f"RMSE of at most {self.most:g} x {name[self.reference]}"


def parse_target(text: str) -> DesignTarget:
    """1.5x-centralised, 2x-bound, or a number in the scenario's unit.

    Raises:
        ValueError: it is none of these.
    """
    found = _FORM.match(text)
    try:
        most = float(found[1]) if found else math.nan
    except ValueError:
        most = math.nan
    if found is None or not (math.isfinite(most) and most > 0):
        raise ValueError(
            f"--target-rmse {text}: must be a positive number in the scenario's unit (8), or a "
            "multiple of a reference (1.5x-centralised, 2x-bound)"
        )
    reference = found[2] or "unit"
    if reference not in (*_REFERENCES, "unit"):
        raise unknown_name("reference of --target-rmse", reference, _REFERENCES)
    if reference != "unit" and most < 1:
        raise ValueError(
            f"--target-rmse {text}: no network is better than its reference; ask for 1 or more"
        )
    return DesignTarget(most, reference)  # type: ignore[arg-type]


def error_of(target: DesignTarget, figures: dict[str, np.ndarray], confidence: float) -> Interval:
    """The error of a candidate as the target measures it, over runs, both sides at `confidence`."""
    squares = np.square(figures["rmse"])
    if target.reference == "centralised":
        return ratio_t(squares, np.square(figures["rmse_centralised"]), confidence)
    if target.reference == "bound":
        return ratio_t(squares, np.square(figures["bound_mean"]), confidence)
    return ratio_t(squares, np.ones_like(squares), confidence)
