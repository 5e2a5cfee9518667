"""Golden transcripts of every fault word and of every phase.

`make stories` writes them anew; read the difference before you commit it.
"""

import os
import re
import textwrap
from pathlib import Path

import pytest

from concord.nodes.environment_state import EnvironmentPhase
from concord.nodes.faults.vocabulary import EVERY_FAULT, PASSING
from concord.nodes.node_state import Phase
from tests.experiments.support import small
from tests.nodes.stories import of_fault, of_phases

FOLDER = Path(__file__).parent / "testdata"
STEPS, FROM, UNTIL = 8, 2, 4
WIDTH = 96
FAULT_INTRODUCTION = """\
{summary}.

Four nodes on a ring estimate the state of an oscillator. Every node sends one frame a step, to its
two neighbours. From step {begin} on "{example}" holds{end}. Each line of a node gives its error,
the age of the shares it holds in cycles, and the counters that grew in this step.
"""
PHASE_INTRODUCTION = """\
{machine} in phase {phase}.

Four nodes on a ring estimate the state of an oscillator. Half of the slots are static, the others
are granted by bids. Node 3 ends at step 1 and is back at step 3; at step 4 a step gets two cycles.
Each line gives an event, the next phase, and the messages sent.
"""
PHASES = {
    **{phase: f"node_in_phase_{phase.value}" for phase in Phase},
    **{phase: f"environment_in_phase_{phase.value}" for phase in EnvironmentPhase},
}


def surely(example: str) -> str:
    """Return a fault's example with its probability at one, or as near as the fault allows."""
    return re.sub(r"\b0\.\d+\b", "0.9" if example.startswith("loss") else "1", example)


def fault_file(word: str) -> Path:
    """Return the file of a fault, named for what happens."""
    first = re.split("[,:]", EVERY_FAULT[word].summary)[0].replace("'s", "")
    summary = re.sub(r"\W+", "_", first)
    return FOLDER / f"{word.replace('-', '_')}_{summary}.txt"


def transcript(introduction: str, lines: list[str]) -> str:
    """Return the text of a file: wrapped paragraphs, then the lines."""
    paragraphs = [textwrap.fill(part, WIDTH) for part in introduction.strip().split("\n\n")]
    return "\n".join(["\n\n".join(paragraphs), *lines]) + "\n"


def hold(file: Path, text: str) -> None:
    """Compare a transcript with its file, or write it when CONCORD_REWRITE is set."""
    if os.environ.get("CONCORD_REWRITE"):
        file.write_text(text, encoding="utf-8")
    assert file.is_file(), f"{file.name} is missing; run `make stories`"
    assert text == file.read_text(encoding="utf-8"), (
        f"{file.name}: the transcript has changed; if that is wanted, run `make stories` and read "
        "the difference"
    )


@pytest.mark.parametrize("word", EVERY_FAULT)
def test_a_fault_is_told(word: str):
    fault = EVERY_FAULT[word]
    example, withdrawal = surely(fault.example), fault.withdrawal
    changes = [f"{FROM} {example}", *([f"{UNTIL} {withdrawal}"] if withdrawal else [])]
    end = f', from step {UNTIL} on "{withdrawal}"' if withdrawal else ""
    if word in PASSING:
        end = " for as many steps as its last number says"
    cluster = "fitted-ab" if fault.needs == "two channels" else "fitted"
    setup = small(graph="ring", rounds=1, steps=STEPS, cluster=cluster)
    introduction = FAULT_INTRODUCTION.format(
        summary=fault.summary.capitalize(), begin=FROM, example=example, end=end
    )
    hold(fault_file(word), transcript(introduction, of_fault(setup, *changes)))


@pytest.mark.parametrize("phase", PHASES)
def test_a_phase_is_told(phase: Phase | EnvironmentPhase, monkeypatch: pytest.MonkeyPatch):
    setup = small(graph="ring", rounds=1, steps=6, schedule="hybrid", occupancy=0.5)
    told = of_phases(setup, monkeypatch, "1 kill 3", "3 restart 3", "4 set rounds=2")[phase]
    machine = "Node 1" if isinstance(phase, Phase) else "The environment"
    introduction = PHASE_INTRODUCTION.format(machine=machine, phase=phase.value)
    assert told or phase is Phase.FINISHED
    lines = told or ["", "  no event arrives: the last estimate ended the run"]
    hold(FOLDER / f"{PHASES[phase]}.txt", transcript(introduction, ["", *lines]))


def test_no_transcript_is_left_over():
    known = {fault_file(word) for word in EVERY_FAULT}
    known |= {FOLDER / f"{name}.txt" for name in PHASES.values()}
    assert set(FOLDER.glob("*.txt")) == known
