"""`concord control`: one command to a network that runs, or how it stands."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from concord.experiments.user_errors import user_errors
from concord.nodes.commands import Answer, in_words
from concord.runtime.network.links import watcher_keys
from concord.runtime.network.network_file import read_network


@dataclass(frozen=True)
class ControlOptions:
    """Which network, and what to do."""

    folder: tyro.conf.Positional[Path]
    """Folder of the run, in which the launcher has written network.json."""
    words: tyro.conf.Positional[tuple[str, ...]]
    """Command: state, pause, resume, step N, speed N, calm. Nodes: kill NODE, restart NODE,
    partition NODE ... Links: cut FROM TO [one-way], heal FROM TO [one-way], loss P [FROM TO
    [one-way]], corrupt P [FROM TO [one-way]]. Settings: set rule=NAME rounds=N ... More words:
    docs/faults.md."""
    keys: Path | None = None
    """For tls/ endpoints: operator.json of `concord keys`; monitor.json for state alone."""
    json: bool = False
    """Print one JSON object."""


def control(options: Annotated[ControlOptions, tyro.conf.arg(name="")]) -> None:
    """Pause, kill, cut or change a network that runs; exit code 2 if it refuses."""
    # A session with a network takes longer to load than all else here.
    from concord.runtime.network.control_client import Client

    with user_errors():
        asks = options.words == ("state",)
        command = None if asks else in_words(options.words)
        network = read_network(options.folder)
        client = Client(network.connect, network.run, watcher_keys(options.keys, network.connect))
        try:
            answer = client.state() if command is None else client.command(command)
        finally:
            client.close()
        _show(answer, options.json)
        if isinstance(answer, Answer) and not answer.accepted:
            raise ValueError(answer.detail)


def _show(answer: Answer | dict, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
    elif isinstance(answer, Answer):
        if answer.accepted:
            sys.stdout.write("accepted\n")
    else:
        pace = "paused" if answer["paused"] else f"{answer['steps_per_second']:g} steps per second"
        if not answer["paused"] and not answer["steps_per_second"]:
            pace = "as fast as possible"
        members = " ".join(map(str, answer["members"]))
        sys.stdout.write(
            f"{answer['run']}: {answer['completed']} steps done, {pace}; nodes {members}\n"
        )
