"""Shared parts of the command-line tests: commands in this process, and Wireshark's decoding."""

import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

from concord.experiments.__main__ import main

needs_tshark = pytest.mark.skipif(
    shutil.which("tshark") is None, reason="tshark is not installed (apt-get install tshark)"
)


class Said(NamedTuple):
    """Exit code and output of a command."""

    code: int
    out: str
    err: str

    def json(self) -> Any:
        """The one object on standard output."""
        return msgspec.json.decode(self.out)


def concord(capsys: pytest.CaptureFixture[str], *arguments: object) -> Said:
    """Run one command in this process."""
    code = 0
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = capsys.readouterr()
    return Said(code, out, err)


def refused(said: Said) -> str:
    """The one sentence of a command that the user got wrong."""
    assert said.code == 2, said
    assert said.out == ""
    assert said.err.startswith("concord: ") and said.err.count("\n") == 1, said.err
    return said.err


def dissect(path: Path, *fields: str) -> list[list[str]]:
    """Fields of each packet as tshark reads them."""
    options = [option for field in fields for option in ("-e", field)]
    result = subprocess.run(
        ["tshark", "-r", str(path), "-T", "fields", "-E", "separator=;", *options],
        capture_output=True,
        text=True,
        check=True,
    )
    return [line.split(";") for line in result.stdout.splitlines()]
