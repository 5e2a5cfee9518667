"""Units of readings, and how other programs spell them."""

import math

UNITS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "m": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180,
    "rad/s": 1.0,
    "deg/s": math.pi / 180,
    "m/s": 1.0,
    "km/h": 1 / 3.6,
    "mph": 0.44704,
    "kn": 1852 / 3600,
    "m/s2": 1.0,
    "g": 9.81,
}
"""Factor from a unit to SI."""
ALIKE = (
    ("s", "ms", "us", "ns"), ("m",), ("rad", "deg"), ("rad/s", "deg/s"),
    ("m/s", "km/h", "mph", "kn"), ("m/s2", "g"),
)  # fmt: skip
"""Units of one quantity, that of SI first."""
_SPELLINGS = (
    ("sec", "s"), ("\u00b5", "u"), ("\u03bc", "u"), ("degrees", "deg"), ("\u00b0", "deg"),
    ("kph", "km/h"), ("kmh", "km/h"), ("knots", "kn"),
    (" s-1", "/s"), (" s-2", "/s2"), ("^", ""), ("**", ""), ("\u00b2", "2"), ("/s/s", "/s2"),
)  # fmt: skip


def unit_of(text: str) -> str:
    """Return the unit that a text such as `[m/s^2]` spells; the text itself for an unknown one."""
    unit = text.strip().strip("[]()").strip()
    for spelled, ours in _SPELLINGS:
        unit = unit.replace(spelled, ours)
    return unit
