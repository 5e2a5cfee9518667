"""Entries of recorded robots and places (`concord.entries`)."""

_HERE = "concord.features.recorded"

SCENARIOS = {
    "mrclam": (
        f"{_HERE}.scenario:DEFINITION",
        "Four real robots track the fifth; needs --data and --target.",
        f"{_HERE}.options:RecordedRobots",
    ),
}
GRAPHS = {
    "intel-lab": (
        f"{_HERE}.intel_lab:BOTH_WAYS",
        "The links of the Intel Berkeley Research lab that deliver frames both ways.",
    ),
    "intel-lab-directed": (
        f"{_HERE}.intel_lab:ONE_WAY",
        "The links of the Intel Berkeley Research lab, some of which go one way.",
    ),
}
CASES = {
    "mrclam": (
        "scenario=mrclam target=4 steps=900 seed=1 runs=1 recorded=yes",
        "four real robots track the fifth (UTIAS MRCLAM): recorded data, no simulated noise",
    ),
}
