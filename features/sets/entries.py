"""Entries of sets that hold the truth for certain (`concord.entries`)."""

_HERE = "concord.features.sets"

NEEDS = ("measurement_bus",)
SCENARIOS = {
    "liu2021": (
        f"{_HERE}.liu2021:DEFINITION",
        "Four sensors of an unstable plant under bounded noise share a slot (Liu et al. 2021).",
        f"{_HERE}.options:BoundedReceiver",
    ),
    "liu2021-network": (
        f"{_HERE}.liu2021_network:DEFINITION",
        "An unstable plant under bounded noise, for sets that hold the truth for certain.",
        f"{_HERE}.options:UnstableBounded",
    ),
}
RULES = {
    "labelled-ellipsoid": (
        f"{_HERE}.rules:LABELLED_ELLIPSOID",
        "labelled with ellipsoids that hold the truth for certain; needs bounded noise.",
        f"{_HERE}.options:EllipsoidFlooding",
    ),
    "ellipsoid": (
        f"{_HERE}.rules:ELLIPSOID",
        "Ellipsoids that intersect and hold the truth for certain; needs bounded noise.",
        f"{_HERE}.options:EllipsoidIntersection",
    ),
    "zonotope": (
        f"{_HERE}.rules:ZONOTOPE",
        "ellipsoid with zonotopes: tighter prediction, wider shares; needs bounded noise.",
        f"{_HERE}.options:ZonotopeIntersection",
    ),
}
RECEIVERS = {
    "ellipsoid": (
        f"{_HERE}.receivers:ELLIPSOID",
        "Ellipsoids behind a measurement bus that hold the truth for certain; needs bounded noise.",
        f"{_HERE}.options:EllipsoidReceiver",
    ),
    "zonotope": (
        f"{_HERE}.receivers:ZONOTOPE",
        "Zonotopes behind a measurement bus that hold the truth for certain; needs bounded noise.",
        f"{_HERE}.options:ZonotopeReceiver",
    ),
}
NAMES = {
    "BoundedPlant": (f"{_HERE}.bounded_plant:BoundedPlant", "A plant under bounded noise."),
    "BoundedOutput": (f"{_HERE}.bounded_plant:BoundedOutput", "One of its outputs."),
    "EllipsoidReceiver": (f"{_HERE}.options:EllipsoidReceiver", "Ellipsoids at a receiver."),
    "ZonotopeReceiver": (f"{_HERE}.options:ZonotopeReceiver", "Zonotopes at a receiver."),
}
CASES = {
    "unstable": (
        "scenario=liu2021-network control=open steps=100 seed=1 runs=30",
        "an open-loop plant whose first state grows; two of six nodes read it; bounded noise, so "
        "the set rules run",
    ),
}
