"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

REFUSED = {
    "keys keys": [
        ("", "--nodes is missing"),
        ("--check", "no keys there"),
        ("--nodes 2 --hosts a/b", "neither a host name"),
    ],
}
