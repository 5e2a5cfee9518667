"""Faults in words: each is read as it is written, and what is none is refused with a cure."""

import msgspec
import pytest

from concord.nodes.changes import UNCHANGED
from concord.nodes.command_checks import check_command
from concord.nodes.commands import Inject, Partition, Refused, in_words, read_command
from concord.nodes.faults.active import Equipment
from concord.nodes.faults.vocabulary import EVERY_FAULT, FAULTS, usage
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario

RING = ((1, 3), (0, 2), (1, 3), (0, 2))


def check(words: str, equipment: Equipment | None = None) -> None:
    full = Equipment("AB", 100.0, 1.0, "<f8", None)
    check_command(in_words(words.split()), RING, UNCHANGED, False, equipment or full)


@pytest.mark.parametrize("word", EVERY_FAULT)
def test_examples_are_what_they_show_and_travel_as_bytes(word: str):
    fault = EVERY_FAULT[word]
    for line in filter(None, (fault.example, fault.withdrawal)):
        command = in_words(line.split())
        assert read_command(msgspec.json.encode(command)) == command
        if fault.needs != "shares of beliefs" and not line.startswith("restart"):
            check(line)
    if word in FAULTS:
        command = in_words(fault.example.split())
        assert isinstance(command, Inject)
        assert len(command.numbers) == len(fault.numbers)
        assert command.numbers[0] != 0
        if fault.withdrawal:
            ends = in_words(fault.withdrawal.split())
            assert isinstance(ends, Inject)
            assert (ends.kind, ends.nodes, ends.numbers[0]) == (command.kind, command.nodes, 0)


def test_numbers_and_nodes_are_told_apart():
    assert in_words(["delay", "0.5", "3"]) == Inject("delay", (), (0.5, 3))
    one_way = Inject("delay", (1, 2), (0.5, 3), both=False)
    assert in_words(["delay", "0.5", "3", "1", "2", "one-way"]) == one_way
    assert in_words(["spoof", "3", "2", "0.5"]) == Inject("spoof", (3, 2), (0.5,))
    assert in_words(["channel", "B", "1"]) == Inject("channel", (1,), (1,))
    assert in_words(["guardian", "1"]) == Inject("guardian", (), (1,))
    assert in_words(["partition", "0", "2"]) == Partition((0, 2))


@pytest.mark.parametrize(
    "line",
    ["corrupt", "corrupt x", "corrupt 0.1 1", "corrupt 0.1 1 2 3", "corrupt 0.1 one-way",
     "hang 1", "hang 1 2 3", "channel C 1", "guardian", "drift 1 2 one-way", "heal 1"],
)  # fmt: skip
def test_what_is_half_said_is_refused_with_how_it_is_said(line: str):
    word = line.split()[0]
    how = usage(word) if word in EVERY_FAULT else "heal [FROM TO"
    with pytest.raises(Refused) as refused:
        in_words(line.split())
    assert how in str(refused.value)


def test_a_wrong_word_gets_the_nearest_and_all():
    with pytest.raises(Refused, match="did you mean 'corrupt'") as refused:
        in_words(["korrupt", "0.1"])
    assert all(word in str(refused.value) for word in EVERY_FAULT)
    with pytest.raises(Refused, match="did you mean 'babble'"):
        check_command(Inject("bubble", (1,), (1,)), RING, UNCHANGED, False)


def test_a_word_that_is_near_to_none_gets_all_and_no_offer():
    with pytest.raises(Refused, match=r"a command is missing\. Commands are pause, resume"):
        in_words([])
    with pytest.raises(Refused, match=r"'quux' is no command\. Commands are pause, resume"):
        in_words(["quux"])
    with pytest.raises(Refused, match=r"fault 'quux'\. Faults are corrupt"):
        check_command(Inject("quux", (1,), (1,)), RING, UNCHANGED, False)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("corrupt 1.5", "corrupt 1.5: P must be from 0 to 1"),
        ("corrupt nan", "P must be from 0 to 1"),
        ("delay 0.5 2.5", "CYCLES must be a whole number from 0 to 64"),
        ("drift 1 20000", "PPM must be from -10000 to 10000"),
        ("corrupt 0.1 0 2", "corrupt 0 2: node 2 does not hear node 0"),
        ("hang 9 3", "hang 9: there are nodes 0 to 3"),
        ("spoof 1 1 0.5", "a node cannot be its own victim"),
        ("partition", "name some of the nodes"),
        ("partition 0 1 2 3", "and not all of them"),
        ("lie 1 5 4", "shares of this rule are no beliefs"),
    ],
)
def test_what_cannot_be_is_refused_with_the_rule(line: str, why: str):
    with pytest.raises(Refused) as refused:
        check(line)
    assert why in str(refused.value)


def test_a_network_without_the_means_is_told_so():
    with pytest.raises(Refused, match="choose a --cluster"):
        check("drift 1 100", Equipment())
    with pytest.raises(Refused, match="channel A alone"):
        check("channel A 1", Equipment())
    with pytest.raises(Refused, match="choose rule ci, wac or hcmci"):
        check("nan 1 1", Equipment())


def refuse(*changes: str, **others: str) -> str:
    with pytest.raises(ValueError) as refused:
        prepare(scenario(nodes=4, graph="ring", changes=changes, **others))
    return str(refused.value)


def test_a_script_is_held_against_the_rule_that_holds_then():
    assert "choose rule ci" in refuse("3 set rule=hcmci", "5 lie 1 5 4")
    prepare(scenario(nodes=4, graph="ring", changes=("3 set rule=hcmci", "2 lie 1 5 4")))
    assert "choose a --cluster" in refuse("3 drift 1 100", bus="ideal")
    assert "channel A alone" in refuse("3 channel B 1")
