"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

SMALL_NETWORKS = {"liu2021-network": {"steps": 4}}
