"""Scripts in files: one change in each line, and errors that name file, line, word and cure."""

from pathlib import Path

import pytest

from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.script import with_files

TEXT = """# a bad night
3 corrupt 0.1     # all links

5 kill 2
 7 restart 2
"""


def test_a_file_stands_for_its_lines(tmp_path: Path):
    file = tmp_path / "faults.txt"
    file.write_text(TEXT)
    lines = ("3 corrupt 0.1", "5 kill 2", "7 restart 2")
    assert with_files(["1 loss 0.5", f"file:{file}"]) == ("1 loss 0.5", *lines)
    options = scenario_of(scenario="oscillator", changes=(f"file:{file}",))
    assert options.changes == lines


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("4 korrupt 0.1", "did you mean 'corrupt'?"),
        ("corrupt 0.1", "must begin with the number of a step"),
        ("4 corrupt", "say corrupt P [FROM TO [one-way]]"),
        ("4 pause", "say it to a network that runs"),
    ],
)
def test_a_bad_line_is_named(line: str, why: str, tmp_path: Path):
    file = tmp_path / "faults.txt"
    file.write_text(f"# first\n1 loss 0.5\n{line}\n")
    with pytest.raises(ValueError) as refused:
        with_files([f"file:{file}"])
    assert f"{file}, line 3: {line!r}" in str(refused.value)
    assert why in str(refused.value)


def test_a_file_that_is_not_there_or_no_text_is_named(tmp_path: Path):
    with pytest.raises(ValueError, match=r"nothing\.txt: cannot be read \(No such file"):
        with_files([f"file:{tmp_path / 'nothing.txt'}"])
    (tmp_path / "no.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"cannot be read \(is no text\)"):
        with_files([f"file:{tmp_path / 'no.txt'}"])
