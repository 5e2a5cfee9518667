"""Target and cost of a design, in a user's words."""

import math
import re
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from concord.results.figures.intervals import Interval, ratio_t
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


class BusLimits(NamedTuple):
    """The longest delay from a measurement to the end of the last share of its step, and the
    greatest load of the bus; None does not limit."""

    latency_ms: float | None = None
    load: float | None = None

    def check(self) -> None:
        """Refuse limits that no network meets.

        Raises:
            ValueError: naming the limit, its value and the rule.
        """
        if self.latency_ms is not None and not self.latency_ms > 0:
            raise ValueError(f"--latency-ms {self.latency_ms:g}: must be above 0")
        if self.load is not None and not 0 < self.load <= 1:
            raise ValueError(f"--load {self.load:g}: must be in (0, 1]")

    def excess(self, figures: dict[str, np.ndarray]) -> str | None:
        """Return the limit that a candidate breaks on the mean of its runs, in words."""
        for limit, name, option, scale in (
            (self.latency_ms, "delay_us", "latency-ms", 1e-3),
            (self.load, "bus_load", "load", 1.0),
        ):
            value = float(figures[name].mean()) * scale
            if limit is not None and not value <= limit:
                has = "a bus without time has none" if np.isnan(value) else f"it has {value:.3g}"
                return f"--{option} {limit:g}: {has}"
        return None


def error_of(target: DesignTarget, figures: dict[str, np.ndarray], confidence: float) -> Interval:
    """The error of a candidate as the target measures it, over runs, both sides at `confidence`."""
    squares = np.square(figures["rmse"])
    if target.reference == "centralised":
        return ratio_t(squares, np.square(figures["rmse_centralised"]), confidence)
    if target.reference == "bound":
        return ratio_t(squares, np.square(figures["bound_mean"]), confidence)
    return ratio_t(squares, np.ones_like(squares), confidence)
