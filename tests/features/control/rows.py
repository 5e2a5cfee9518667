"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

OPTIONS_OF_A_SCENARIO = {
    "--noise matched": "--scenario cruise-control",
    "--control 0": "--scenario cruise-control",
}
SMALL_NETWORKS = {"dc-motor-speed": {"steps": 12, "loss": 0.2}}
PAGES = {"control": ""}
