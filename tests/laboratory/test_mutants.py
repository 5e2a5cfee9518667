"""The sample of mutants is honest: the same for a seed, and scored against all that were drawn."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import ROOT
from tests.laboratory import mutants
from tests.laboratory.mutant_trials import quickest
from tests.laboratory.mutants import (
    FOLDERS,
    MutantOptions,
    Score,
    drawn,
    mutable,
    places_of,
    written,
)

NAMES = [f"concord.filters.x_f__mutmut_{number}" for number in range(200)]


@given(seed=st.integers(0, 1000), count=st.integers(1, 199))
def test_a_seed_draws_the_same_mutants(seed: int, count: int):
    options = MutantOptions(mutants=count, seed=seed)
    sample = drawn(NAMES, options)
    assert sample == drawn(NAMES, options)
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
    kinds = ["caught"] * caught + ["not reached"] * unreached
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
    assert (ROOT / "concord" / folder).is_dir()
    assert places_of(folder, ()) != []
    assert places_of(folder, ("test_one",)) == [f"tests/{folder}/test_one.py"]


def test_only_drawn_mutants_are_written_and_each_changes_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "setup.cfg").write_text(mutants.SETTINGS)
    path = Path("filters") / "sums.py"
    path.parent.mkdir()
    path.write_text("class A:\n    most = 3\n\n\ndef f(x):\n    y = x + 1\n    return y * 2\n")
    file = mutable(path)
    chosen = file.mutants[1:3]
    changes = written(file, chosen)
    assert list(changes) == [f"concord.filters.sums.x_f__mutmut_{i}" for i in (1, 2)]
    for change in changes.values():
        assert sum(line.startswith("+ ") for line in change.splitlines()) == 1
    assert path.read_text().count("__mutmut_2(") == 1
    assert "__mutmut_3" not in path.read_text()


def test_without_mutmut_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(mutants, "find_spec", lambda name: None)
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    with pytest.raises(SystemExit, match="mutmut is not installed"):
        mutants.mutants(MutantOptions())
    assert list(tmp_path.iterdir()) == []
