"""Entries of several targets (`concord.entries`)."""

_HERE = "concord.features.several_targets"

SCENARIOS = {
    "target-swarm": (
        f"{_HERE}.scenario:DEFINITION",
        "Several targets that come and go, seen with misses and clutter; detections have no names.",
        f"{_HERE}.options:TargetSwarm",
    ),
}
RULES = {
    "track-ci": (
        "",
        "Tracks of several targets, fused by covariance intersection (target-swarm).",
        f"{_HERE}.options:TrackIntersection",
    ),
}
FIGURES = {
    "tracks": (f"{_HERE}.figure_names:FIGURES", "Scores of the tracks of several targets."),
}
