"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

REFUSED = {
    "topology analyse": [("/tmp", "no folder of the Intel lab data")],
}
OPTIONS_OF_A_SCENARIO = {"--target 4": "--scenario mrclam"}
