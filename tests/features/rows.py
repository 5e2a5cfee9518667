"""Rows of features in the tables of the core's tests: `tests/features/*/rows.py`."""

from importlib import import_module
from typing import Any

from tests.conftest import ROOT


def rows_of_features(table: str) -> dict[str, Any]:
    """Return the rows that all features have under the name of a table."""
    found: dict[str, Any] = {}
    for file in sorted(ROOT.glob("tests/features/*/rows.py")):
        module = import_module(f"tests.features.{file.parent.name}.rows")
        rows: dict[str, Any] = getattr(module, table, {})
        assert not found.keys() & rows.keys(), f"two features have one row of {table}"
        found |= rows
    return found
