"""Faults of a user's function: a sentence with its last line, in place of our traceback."""

import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import walk_tb
from types import FrameType

from concord.disk import RunFailed

_LIBRARIES = tuple(sysconfig.get_path(kind) for kind in ("stdlib", "purelib", "platlib"))


class UserFault(RunFailed):
    """A function of the user has raised an exception in a run."""


@contextmanager
def user_faults() -> Iterator[None]:
    """Turn the exception of a user's function, called by concord, into a sentence.

    Raises:
        UserFault: with file, line, function, and the text of the exception, which is its cause.
    """
    try:
        yield
    except RunFailed:
        raise
    except Exception as error:
        if not last_line(error):
            raise
        raise UserFault(f"{fault_sentence(error)}; correct that function") from error


def fault_sentence(error: BaseException) -> str:
    """Return kind and text of an exception in one line, after the user's last line if it has one:
    "FILE line 18, in rule: RuntimeError: text"."""
    words = [last_line(error), type(error).__name__, " ".join(str(error).split())]
    return ": ".join(word for word in words if word)


def last_line(error: BaseException) -> str:
    """Return "FILE line 18, in rule" of the last line of a user's function that concord called; ""
    where concord called none."""
    is_called, found = False, ""
    for frame, line in walk_tb(error.__traceback__):
        module = frame.f_globals.get("__name__", "")
        if module.startswith("concord.") and module != __name__:
            is_called = True
        elif is_called and _is_of_user(frame):
            found = f"{frame.f_code.co_filename} line {line}, in {frame.f_code.co_name}"
    return found


def _is_of_user(frame: FrameType) -> bool:
    """Whether a frame is neither of Python nor of an installed library."""
    module = str(frame.f_globals.get("__name__", "")).partition(".")[0]
    if module in sys.stdlib_module_names and module != "__main__":
        return False
    file = Path(frame.f_code.co_filename)
    return not any(file.is_relative_to(library) for library in _LIBRARIES)
