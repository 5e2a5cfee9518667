"""The commands of `deploy/`, as systemd or Kubernetes would start them."""

import shlex
from collections.abc import Mapping
from pathlib import Path

DEPLOY = Path(__file__).parents[2] / "deploy"
UNITS = DEPLOY / "systemd"
CONCORD = "/opt/concord/bin/concord"


def unit_command(unit: str, environment: Mapping[str, str], instance: str = "") -> list[str]:
    """Return the arguments of the command that a unit starts, without the program's name.

    `${NAME}` becomes one word, and `$NAME` as many words as it has.
    """
    lines = (UNITS / unit).read_text().splitlines()
    [line] = [line.removeprefix("ExecStart=") for line in lines if line.startswith("ExecStart=")]
    program, *said = shlex.split(line.replace("%i", instance))
    assert program == CONCORD
    words: list[str] = []
    for word in said:
        if word.startswith("$") and not word.startswith("${"):
            words += environment[word[1:]].split()
            continue
        for name, value in environment.items():
            word = word.replace(f"${{{name}}}", value)
        words.append(word)
    assert not any("$" in word for word in words), words
    return words


def credentials(unit: str, keys: Path, folder: Path, instance: str = "") -> Path:
    """The folder in which a unit finds the files that systemd loads for it, and no other."""
    folder.mkdir()
    for line in (UNITS / unit).read_text().splitlines():
        if line.startswith("LoadCredential="):
            name, source = line.removeprefix("LoadCredential=").replace("%i", instance).split(":")
            (folder / name).write_bytes((keys / Path(source).name).read_bytes())
            # Only the user of the service may read a credential (systemd.exec, "Credentials").
            (folder / name).chmod(0o400)
    return folder
