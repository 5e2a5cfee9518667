"""Entries of a car and of filters that learn noise or resist outliers (`concord.entries`)."""

_HERE = "concord.features.vehicle"

SCENARIOS = {
    "vehicle-network": (
        f"{_HERE}.scenario:DEFINITION",
        "A car's sensors on its FlexRay bus estimate its motion; `aukf` learns their noise.",
        f"{_HERE}.options:VehicleNetwork",
    ),
}
FILTERS = {
    "mcukf": (
        f"{_HERE}.learning_filters:MCUKF",
        "Maximum-correntropy unscented Kalman filter: outliers lose their weight.",
        f"{_HERE}.options:MaximumCorrentropy",
    ),
    "aukf": (
        f"{_HERE}.learning_filters:AUKF",
        "Adaptive unscented Kalman filter: learns R by Sage and Husa's fading average.",
        f"{_HERE}.options:AdaptiveUnscented",
    ),
    "faukf": (
        f"{_HERE}.learning_filters:FAUKF",
        "Fuzzy adaptive unscented Kalman filter: learns R from the size of innovations.",
        f"{_HERE}.options:FuzzyUnscented",
    ),
    "adlukf": (
        f"{_HERE}.learning_filters:ADLUKF",
        "Adaptive dual-layer unscented Kalman filter, each reading counted once; learns R.",
        f"{_HERE}.options:AdaptiveDualLayer",
    ),
}
COMMANDS = {
    "identify-car": (
        f"{_HERE}.identify_command:identify_tyres",
        "Find the tyres, the sensors and the process noise that explain a drive best.",
        "page",
    ),
}
CASES = {
    "vehicle": (
        "scenario=vehicle-network filter=ukf noise=matched cluster=fitted steps=600 seed=1 runs=20",
        "a car's four sensor nodes on a complete graph: few nodes, and rule centralised runs",
    ),
}
