"""Fixtures of the tests of commands."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure


@pytest.fixture
def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands compose their pictures and write empty files, which takes less time."""

    def saved(_: Figure, place: object, **__: object) -> None:
        if isinstance(place, Path):
            place.touch()

    monkeypatch.setattr(Figure, "savefig", saved)
