"""Messages for callers from Python: options are keywords there, and not flags."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

_FLAG = re.compile(r"--([a-z][a-z0-9-]*)")


@contextmanager
def python_words() -> Iterator[None]:
    """Raise a ValueError with `window_steps` where its message has `--window-steps`."""
    try:
        yield
    except ValueError as error:
        text = _FLAG.sub(lambda flag: flag[1].replace("-", "_"), str(error))
        raise ValueError(text) from error
