"""`concord identify` on the command line: a table, a file, and errors of one sentence."""

import json
from pathlib import Path

import pytest

from concord.experiments.__main__ import main
from tests.experiments.command_support import concord, refused


def test_it_prints_values_and_verdicts_and_writes_the_file(tmp_path: Path, capsys):
    file = tmp_path / "new" / "found.toml"
    asked = ["oscillator", "--steps", "80", "--seek", "R.position", "-o", str(file)]
    main(["identify", *asked])
    said = capsys.readouterr().out
    for words in ("R.position", "before: NIS", "after:  NIS", f"--identified {file}"):
        assert words in " ".join(said.split()) or words in said.replace("\n", "")
    main(["run", "--scenario", "oscillator", "--steps", "30", "--identified", str(file),
          "-o", str(tmp_path / "run")])  # fmt: skip


def test_json_has_the_same(capsys):
    main(["identify", "oscillator", "--steps", "80", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["ended"] and said["found"][0][0].startswith("R.")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--seek", "R.gps"], "Valid names are R.position"),
        (["--seek", "delay.position"], "these readings are simulated"),
        (["--seek", "R.position,R.position"], "a name is there twice"),
        (["--scenario", "oscillator"], "name one scenario"),
        (["--out", "/"], "the file exists"),
    ],
)
def test_a_mistake_is_one_sentence(arguments: list[str], says: str, capsys):
    assert says in refused(concord(capsys, "identify", "oscillator", *arguments))


def test_a_scenario_that_cannot_be_identified_is_refused(capsys):
    assert "name another scenario" in refused(concord(capsys, "identify", "liu2021"))
