"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

OPTIONS_OF_A_SCENARIO = {
    "--static-slots 3": "--scenario meng2025-network or --schedule flexray",
}
PAGES = {"measurement_bus": ""}
