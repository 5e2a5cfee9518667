"""A user's mistake on the command line: one sentence on standard error and exit code 2."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

USER_ERROR = 2


@contextmanager
def user_errors() -> Iterator[None]:
    """Wrap what checks the user's wishes: a ValueError in here is a sentence for the user.

    Only that: a ValueError from anywhere else is a bug of ours and keeps its traceback.
    """
    try:
        yield
    except ValueError as error:
        sys.stderr.write(f"concord: {error}\n")
        sys.exit(USER_ERROR)
