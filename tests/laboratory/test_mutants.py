"""The sample of mutants is honest: the same for a seed, and scored against all that were drawn."""

import random
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import ROOT
from tests.laboratory import mutants
from tests.laboratory.mutants import FOLDERS, MutantOptions, Score, drawn, quickest, settings

NAMES = [f"concord.filters.x_f__mutmut_{number}" for number in range(200)]


@given(seed=st.integers(0, 1000), count=st.integers(1, 199))
def test_a_seed_draws_the_same_mutants_in_any_order(seed: int, count: int):
    options = MutantOptions(mutants=count, seed=seed)
    shuffled = random.Random(seed + 1).sample(NAMES, len(NAMES))
    sample = drawn(NAMES, options)
    assert sample == drawn(shuffled, options)
    assert len(set(sample)) == count
    assert set(sample) <= set(NAMES)


def test_another_seed_draws_others_and_zero_draws_all():
    one, other = (drawn(NAMES, MutantOptions(mutants=50, seed=seed)) for seed in (1, 2))
    assert one != other
    assert drawn(NAMES, MutantOptions(mutants=0)) == NAMES


@given(st.dictionaries(st.text(min_size=1), st.floats(0.01, 20), min_size=1), st.floats(0.1, 60))
def test_a_mutant_meets_the_quickest_tests_within_the_time(
    seconds: dict[str, float], most_s: float
):
    kept = quickest(list(seconds), seconds, most_s)
    left_out = set(seconds) - set(kept)
    assert kept
    assert len(kept) == 1 or sum(seconds[name] for name in kept) <= most_s * (1 + 1e-12)
    assert all(seconds[name] >= max(map(seconds.__getitem__, kept)) for name in left_out)


@given(caught=st.integers(0, 60), unreached=st.integers(0, 20))
def test_the_score_counts_every_drawn_mutant(caught: int, unreached: int):
    """Wilson's bounds are the roots p of (caught / n - p)^2 = 1.96^2 p (1 - p) / n."""
    total = 80
    kinds = ["killed"] * caught + ["no tests"] * unreached
    kinds += ["survived"] * (total - len(kinds))
    score = Score("filters", 9000, dict(zip(NAMES[:total], kinds, strict=True)))
    cells = [cell.strip() for cell in score.line().strip("|").split("|")]
    assert cells[:6] == [
        "`filters/`", "9000", "80", str(caught), str(unreached), str(total - caught - unreached),
    ]  # fmt: skip
    share, low, high = (
        float(word) / 100 for word in cells[6].replace("%", "").translate(_BRACKETS).split()
    )
    assert share == pytest.approx(caught / total, abs=0.0051)

    def excess(p: float) -> float:
        return (caught / total - p) ** 2 - 1.96**2 * p * (1 - p) / total

    # The table has whole per cents.
    for bound in (low, high):
        assert excess(bound - 0.0051) * excess(bound + 0.0051) <= 0


_BRACKETS = str.maketrans({"(": " ", ")": " ", "t": " ", "o": " "})


@pytest.mark.parametrize("folder", FOLDERS)
def test_each_folder_and_its_tests_are_there(folder: str):
    text = settings(folder, ())
    assert f"source_paths=concord/{folder}" in text
    assert (ROOT / "concord" / folder).is_dir()
    assert (ROOT / "tests" / folder).is_dir()
    chosen = settings(folder, ("test_one",))
    assert f"    tests/{folder}/test_one.py\n" in chosen
    assert f"    tests/{folder}\n" not in chosen


def test_without_mutmut_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(mutants, "find_spec", lambda name: None)
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    with pytest.raises(SystemExit, match="mutmut is not installed"):
        mutants.mutants(MutantOptions())
    assert list(tmp_path.iterdir()) == []
