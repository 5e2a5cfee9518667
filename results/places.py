"""Where results are kept: folders that a user has named, made or refused, and unique names."""

import re
import secrets
import time
from pathlib import Path


def new_name(what: str) -> str:
    """A unique name for a result: of a run of this scenario, of a sweep, of a design."""
    # Local time to the second reads well in a listing; the suffix makes it unique.
    shown = re.sub(r"[^\w.-]+", "-", what.strip("./"))
    return f"{shown}-{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(3)}"


def make_folder(folder: Path, option: str, named: Path | None = None) -> None:
    """Make a folder and those above it, if they are not there yet; `named` is what the user called
    it by, when that is something else.

    Raises:
        ValueError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        whose = f"{option} {folder}:" if named is None else f"{option} {named}: its folder"
        raise ValueError(
            f"{whose} cannot be made ({error.strerror}); choose another place"
        ) from None
