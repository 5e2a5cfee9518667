"""The project keeps the prose rules; the checker finds planted violations of each rule."""

from pathlib import Path

import pytest

from tests.prose.check import ROOT, files, findings, sentences

FITS = " ".join(["Word"] + ["word"] * 33)
LONG = f"{FITS} word word."
PLANTED = [
    ("nodes/a.py", '"""Who sends is heard."""', "opens with 'Who'"),
    ("nodes/a.py", '"""Send it. Whoever hears it counts it."""', "opens with 'Whoever'"),
    ("nodes/a.py", "# Nobody waits for a\n# neighbour.", "opens with 'Nobody'"),
    ("nodes/a.py", "x = 1  # what a link loses", "opens with 'what'"),
    ("docs/a.md", "One fact. All that is sent is counted.", "opens with 'All that'"),
    ("docs/a.md", "| a | such frames are lost |\n", "opens with 'such'"),
    ("docs/a.md", "- One that waits is late.", "opens with 'One that'"),
    ("tests/a.py", '"""Somebody else takes the port."""', "opens with 'Somebody'"),
    ("docs/a.md", LONG, "36 words"),
    ("nodes/a.py", f'"""{LONG}"""\nx: int', "36 words"),
    ("docs/a.md", "one two three four five six seven\n30. " + LONG, "36 words"),
    ("docs/a.md", f"- {FITS}\n    word word.", "36 words"),
    ("docs/a.md", "The zygote forks the nodes.", "write 'launcher process'"),
    ("docs/a.md", "A node waits for all frames of a part of a cycle.", "write 'group'"),
    ("runtime/a.py", "class _Office: pass", "name it 'environment process'"),
    ("runtime/a.py", "def all_eras(): pass", "name it 'segment'"),
    ("runtime/peer_patience.py", "x = 1", "name it 'peer timeout'"),
    ("nodes/a.py", "def f(said): pass", "name it 'republisher'"),
    ("features/sets/a.py", "def carry(): pass", "name it 'predict'"),
    ("docs/a.md", f"{'<' * 7} HEAD\nOne text.", "a merge was left open"),
    ("results/a.py", "class Kind: pass", "name it 'scenario definition'"),
]
ALLOWED = [
    ("nodes/a.py", '"""Return the frame that a node sends. Units: metres."""'),
    ("nodes/a.py", '"""Refuse "what a user wrote" and `Who`."""\n# noqa: E501'),
    ("docs/a.md", "# What is it?\n\n```sh\nconcord world --zygote\n```\n> What he said.\n"),
    ("docs/a.md", f"{FITS}. {FITS}! **{FITS}.** {FITS}.\n- {FITS}\n- {FITS}\n"),
    ("docs/a.md", f"1. {FITS}\n2. {FITS}\n\n{FITS}\n"),
    ("docs/a.md", f"{FITS}:\n\n    {FITS}\n    {FITS}\n\n{FITS}\n"),
    ("nodes/a.py", f'"""Attributes: one: {FITS[:99]}. two: {FITS}."""'),
    ("docs/a.md", "| who | what |\n|---|---|\n"),
    ("tests/a.py", "conductor = 1"),
    ("dashboard/a.py", "page = part = 1"),
    ("nodes/a.py", "said_again = 1"),
    ("features/hosts/a.py", "listen = said = 1"),
    ("topology/a.py", '"""Return a small-world graph."""\nsmall_world = 1'),
]


@pytest.mark.parametrize(("path", "text", "rule"), PLANTED)
def test_a_planted_violation_is_found_with_its_rule(
    tmp_path: Path, path: str, text: str, rule: str
):
    (finding,) = _findings(tmp_path, path, text)
    assert rule in str(finding) and str(finding).startswith(f"{path}:1: ")


@pytest.mark.parametrize(("path", "text"), ALLOWED)
def test_allowed_prose_passes(tmp_path: Path, path: str, text: str):
    assert not _findings(tmp_path, path, text)


def test_the_project_keeps_the_rules():
    found = [str(finding) for file in files([ROOT]) for finding in findings(file)]
    if found:
        pytest.fail("\n".join(found), pytrace=False)


def test_an_abbreviation_ends_no_sentence():
    text = "Use a graph, e.g. Ring, of eq. 3 (Olfati-Saber et al. 2007). Then run it! 2 nodes do."
    assert len(list(sentences(text))) == 3


def _findings(root: Path, path: str, text: str):
    file = root / path
    file.parent.mkdir(parents=True)
    file.write_text(text, encoding="utf-8")
    return findings(file, root)
