"""Entries of recorded robots and places (`concord.entries`)."""

_HERE = "concord.features.recorded"

SCENARIOS = {
    "mrclam": (
        f"{_HERE}.scenario:DEFINITION",
        "Four real robots track the fifth; needs --data and --target.",
        f"{_HERE}.options:RecordedRobots",
    ),
}
