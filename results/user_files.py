"""Copies of the user files of a run in its folder: of its plant, rule, filter, bus and arbiter."""

import shutil
from pathlib import Path

import msgspec

from concord.runtime.disk import writing
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.option import Choice
from concord.scenarios.types.schedules import arbiter_of
from concord.scenarios.user.values import (
    FromFile,
    ValueSource,
    file_of,
    is_source_name,
    source_of,
)

_FIELDS = ("plant", "rule", "bus", "filter")


def keep_copies(folder: Path, scenario: Scenario) -> None:
    """Copy the user's files of a scenario into the folder of its run."""
    for source in _sources(scenario):
        copy = _copy(folder, source)
        with writing(copy):
            shutil.copyfile(file_of(source), copy)


def from_copies(folder: Path, scenario: Scenario) -> Scenario:
    """The scenario with the copies in the folder of its run, where there are some."""
    changed = {}
    for field in _FIELDS:
        choice: Choice = getattr(scenario, field)
        if isinstance(choice, FromFile) and _copy(folder, choice.where).is_file():
            name = choice.source.rpartition(":")[2]
            copied = f"{_copy(folder, choice.where)}:{name}"
            changed[field] = msgspec.structs.replace(choice, source=copied)
    scenario = msgspec.structs.replace(scenario, **changed)
    arbiter = arbiter_of(scenario.bus.schedule)
    if is_source_name(arbiter) and _copy(folder, source_of(arbiter)).is_file():
        name, digest = arbiter.rpartition(":")[2].split("#")
        copied = f"{_copy(folder, source_of(arbiter))}:{name}#{digest}"
        return scenario.with_(arbiter=copied)
    return scenario


def _sources(scenario: Scenario) -> list[ValueSource]:
    choices = [getattr(scenario, field) for field in _FIELDS]
    found = [one.where for one in choices if isinstance(one, FromFile)]
    arbiter = arbiter_of(scenario.bus.schedule)
    found += [source_of(arbiter)] if is_source_name(arbiter) else []
    return [source for source in found if source.digest]


def _copy(folder: Path, source: ValueSource) -> Path:
    stem = source.name.rpartition(":")[0].removesuffix(".py").replace("/", ".").rpartition(".")[2]
    return folder / f"{stem}-{source.digest}.py"
