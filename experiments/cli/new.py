"""`concord new`: write the folder of a study, which runs as it is written."""

import os
import re
import shutil
import sys
from pathlib import Path
from typing import Annotated

import tyro

from concord.disk import writing
from concord.experiments.first_model import first_model
from concord.experiments.user_errors import user_errors

_TEMPLATES = Path(__file__).parent.parent / "study"
_SUFFIX = ".template"


def new(
    name: Annotated[
        str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME", help="Name of the new folder.")
    ],
    from_log: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Log (CSV, netCDF, MCAP, ULog), for its columns and a first model in the folder.",
        ),
    ] = None,
) -> None:
    """Write a folder with a plant, a rule, tests, a sweep and a figure of your own."""
    with user_errors():
        folder = _free_folder(name)
        texts = _templates(name) if from_log is None else first_model(from_log, folder)
    # A folder under another name until it is complete.
    unfinished = folder.with_name(f".{name}.unfinished")
    try:
        with writing(folder):
            unfinished.mkdir()
            for file, text in texts.items():
                (unfinished / file).write_text(text, "utf-8")
            unfinished.rename(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    following = f"cd {name} && make {_python(folder)}test"
    if from_log is not None:
        following = f"concord run --scenario {name}/model.py:SCENARIO"
    sys.stdout.write(f"{name}/ is written; next: {following}\n")


def _templates(name: str) -> dict[str, str]:
    """The files of a study, by their names."""
    return {
        template.name.removesuffix(_SUFFIX): template.read_text("utf-8").replace("@NAME@", name)
        for template in sorted(_TEMPLATES.glob(f"*{_SUFFIX}"))
    }


def _python(folder: Path) -> str:
    """Return how `make` in a folder is told the interpreter; nothing where it finds that itself."""
    found = shutil.which("python3")
    if found is not None and Path(found).parent == Path(sys.executable).parent:
        return ""
    return f"PYTHON={min(sys.executable, os.path.relpath(sys.executable, folder), key=len)} "


def _free_folder(name: str) -> Path:
    """Return the folder of a study.

    Raises:
        ValueError: a name that is none, or a place that is taken.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", name):
        raise ValueError(
            f"{name!r}: the name of a study must begin with a letter and have letters, digits, - "
            "and _ only; it becomes a folder here"
        )
    folder = Path(name)
    if folder.exists() or folder.is_symlink():
        raise ValueError(f"{name}: is there already; choose another name, or remove it first")
    return folder
