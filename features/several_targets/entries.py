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
CASES = {
    "targets": (
        "scenario=target-swarm nodes=10 targets=3 clutter=1 steps=40 occupancy=0.25 seed=1 runs=10",
        "three targets, clutter and misses: 10 nodes of target-swarm with a quarter of the bus",
    ),
}
