"""Fresh Python interpreters that run a module of concord.

A user's working folder may hold a `nodes.py` or `filters.py`. A fresh interpreter must not import
it in place of concord's own, so it starts with a safe path and is told where concord lies.
"""

import os
import sys
from pathlib import Path

# Not resolved: in a checkout, `concord` holds links to the folders.
_ROOT = Path(__file__).absolute().parents[2]


def fresh_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs `module`, without the working folder on its path."""
    return [sys.executable, "-P", "-m", module, *arguments]


def fresh_variables(**more: str) -> dict[str, str]:
    """Return this process's environment variables and `more`, with concord's folder on the path."""
    path = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path), **more}
