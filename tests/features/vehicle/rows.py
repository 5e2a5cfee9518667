"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

OPTIONS_OF_A_SCENARIO = {
    "--car bmw-320i": "--scenario vehicle-network",
    "--manoeuvre serpentine": "--scenario vehicle-network",
}
