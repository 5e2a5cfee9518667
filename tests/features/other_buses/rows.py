"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

BUSES_OF_LONG_SHARES = {"plca": ""}
BUSES_OF_SHORT_SHARES = {"can-fd": "15120 bytes need 270 frames of 60 bytes"}
PAGES = {"buses": ""}
