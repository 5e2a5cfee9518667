"""Folders that a user has named, made or refused."""

from pathlib import Path


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
