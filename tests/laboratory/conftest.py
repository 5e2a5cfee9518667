"""Run parts of the laboratory in the tests' own process."""

from collections.abc import Callable

import pytest

from tests.experiments.command_support import Said
from tests.laboratory.__main__ import main


@pytest.fixture
def laboratory(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """A function of the words of a part: its exit code and output."""

    def run(*words: object) -> Said:
        code = 0
        try:
            main([str(word) for word in words])
        except SystemExit as ended:
            code = int(ended.code or 0)
        out, err = capsys.readouterr()
        return Said(code, out, err)

    return run
