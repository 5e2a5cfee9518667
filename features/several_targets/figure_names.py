"""Figures of several targets for `concord.results.figures.figure_table`, without their functions.

Reason for a file of its own: each sweep loads it, and the functions only where targets are.
"""

_SCORES = {
    "ospa": ("m", "mean OSPA of several targets"),
    "missed_targets": ("1", "mean number of targets without a track"),
    "false_tracks": ("1", "mean number of tracks without a target"),
    "cardinality_error": ("1", "mean error of the number of targets"),
    "identity_switches": ("1", "changes of the track of a target in a run, mean over the nodes"),
    "steps_to_confirm": ("1", "mean steps from a target's first to that of its track"),
}
FIGURES = {
    **{name: (("run",), unit, meaning) for name, (unit, meaning) in _SCORES.items()},
    **{
        f"{name}_centralised": (("run",), unit, "the same of one tracker with all scans")
        for name, (unit, _) in _SCORES.items()
    },
}
"""Dimensions, unit and meaning of each; NaN for scenarios with one target."""
