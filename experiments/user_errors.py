"""A user's mistake on the command line: one sentence on standard error and exit code 2."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

FAILED, USER_ERROR = 1, 2
_LONG_WORD = re.compile(r"(\S{60})\S{940,}")


@contextmanager
def user_errors() -> Iterator[None]:
    """Wrap what checks the user's wishes: a ValueError in here is a sentence for the user.

    Only that: a ValueError from anywhere else is a bug of ours and keeps its traceback.
    """
    try:
        yield
    except ValueError as error:
        sentence = _LONG_WORD.sub(r"\1...", str(error))
        sys.stderr.write(f"concord: {sentence}\n")
        sys.exit(USER_ERROR)
