"""Entries of the measurement bus (`concord.entries`)."""

_HERE = "concord.features.measurement_bus"

SCENARIOS = {
    "meng2025": (
        f"{_HERE}.meng2025:DEFINITION",
        "Six sensors share one slot per step to an estimator (Meng et al. 2025).",
        f"{_HERE}.options:StochasticReceiver",
    ),
    "meng2025-network": (
        f"{_HERE}.meng2025_network:DEFINITION",
        "A network of estimators as in meng2025, each behind a measurement bus of its own.",
        f"{_HERE}.options:StochasticNetwork",
    ),
}
RULES = {
    "reception": (
        "",
        "One node estimates what the others send over a measurement bus (meng2025, liu2021).",
        f"{_HERE}.options:Reception",
    ),
}
RECEIVERS = {
    "recommended": (
        f"{_HERE}.receivers:RECOMMENDED_RECEIVER",
        "Unscented filter with exact moments of noise that grows with the state (meng2025).",
        f"{_HERE}.options:RecommendedFilter",
    ),
}
SCHEDULES = {
    "flexray": (
        "",
        "Some sensors of a measurement bus own a slot each, the others contend for one (meng2025).",
        f"{_HERE}.options:SensorSlots",
    ),
    "none": (
        "",
        "No sensor of a measurement bus ever sends (meng2025).",
        f"{_HERE}.options:SilentSchedule",
    ),
}
NAMES = {
    "on_a_measurement_bus": (
        f"{_HERE}.own_measured:on_a_measurement_bus",
        "A scenario of your own plant whose sensors share a bus to one estimator.",
    ),
    "SensorSlots": (f"{_HERE}.options:SensorSlots", "Slots of the sensors on such a bus."),
}
