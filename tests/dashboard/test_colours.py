"""Any two meanings of the page have colours that the colour-blind can tell apart."""

import re
from itertools import combinations

import numpy as np
import pytest

from concord.dashboard.frames.stage import set_stage
from concord.dashboard.panels.table import status
from concord.dashboard.theme import DARK, LIGHT, Theme, relative_luminance
from tests.dashboard.colour_vision import SIGHT, difference, lab
from tests.dashboard.runs import setup_of

MEANINGS = (
    "seeing", "blind", "stale", "sending", "down", "truth", "fused", "estimate", "selection",
    "edge",
)  # fmt: skip
LEAST = 10.0


@pytest.mark.parametrize("theme", [DARK, LIGHT], ids=["dark", "light"])
@pytest.mark.parametrize("sight", SIGHT)
def test_two_meanings_are_never_too_close(theme: Theme, sight: str):
    seen = {name: lab(getattr(theme, name), sight) for name in MEANINGS}
    close = {
        pair: difference(seen[pair[0]], seen[pair[1]])
        for pair in combinations(MEANINGS, 2)
        if difference(seen[pair[0]], seen[pair[1]]) < LEAST
    }
    assert close == {}


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_the_difference_is_that_of_the_published_pairs(one: tuple, other: tuple, apart: float):
    """Source: Sharma, Wu and Dalal (2005), table 1, pairs 1, 4, 17 and 34."""
    assert difference(np.array(one), np.array(other)) == pytest.approx(apart, abs=1e-4)
    assert difference(np.array(other), np.array(one)) == pytest.approx(apart, abs=1e-4)


def test_white_is_neutral_to_every_sight():
    for sight in SIGHT:
        assert lab((255, 255, 255), sight) == pytest.approx([100, 0, 0], abs=0.6)


@pytest.mark.parametrize("theme", [DARK, LIGHT], ids=["dark", "light"])
def test_the_state_of_the_run_can_be_read(theme: Theme):
    """Source: WCAG 2.2, success criterion 1.4.3: a contrast of 4.5 for small letters."""
    stage = set_stage(setup_of("oscillator", nodes=3, steps=2))
    for state in ("RUNNING", "PAUSED", "ENDED", "SILENT", "LOADING"):
        html = status(stage, theme, None, state)
        pill = html[: html.index("</span>")]
        ((ground, letters),) = re.findall("background:#(......);color:#(......)", pill)
        dark, light = sorted(relative_luminance(_colour(code)) for code in (ground, letters))
        assert (light + 0.05) / (dark + 0.05) > 4.5, state


def _colour(code: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(code)
    return red, green, blue
