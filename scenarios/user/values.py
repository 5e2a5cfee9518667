"""Values that a user brings: a name in a Python file or module, or an object of this session.

A setup holds the name and the digest of the file, and no code. So every process of a network, on
any host, reads the file itself, and refuses another one than that of the setup.
"""

import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

from concord.topology.names import unknown_name

_SESSION = "session"
Wanted = TypeVar("Wanted")
_kept: dict[str, object] = {}


class ValueSource(NamedTuple):
    """Where a value of the user stands: `name` is FILE.py:NAME, package.module:NAME, or session:N
    for an object that no file holds; `digest` is that of the file, empty for session:N."""

    name: str
    digest: str = ""


class FromFile:
    """A choice that a file of the user defines; its fields are those of a `ValueSource`."""

    __slots__ = ()
    source: str
    digest: str

    @property
    def name(self) -> str:
        """The name of the value in its file."""
        return self.source

    @property
    def where(self) -> ValueSource:
        """Where the value is defined."""
        return ValueSource(self.source, self.digest)


def is_source_name(text: object) -> bool:
    """Whether a text names a value in a Python file or module."""
    if not isinstance(text, str):
        return False
    place, colon, name = text.partition("#")[0].rpartition(":")
    is_file = place.endswith(".py") or all(word.isidentifier() for word in place.split("."))
    return bool(colon) and name.isidentifier() and is_file and ("." in place or place == _SESSION)


def pinned(name: str) -> str:
    """The name of a value with the digest of its file as it is now: FILE.py:NAME#DIGEST.

    Raises:
        ValueError: there is no such file or module.
    """
    source = source_of(name)
    return f"{source.name}#{source.digest}" if source.digest else name


def source_of(name: str) -> ValueSource:
    """Return the source of a name, with its own digest, or that of its file as it is now.

    Raises:
        ValueError: there is no such file or module.
    """
    if "#" in name:
        return ValueSource(*name.split("#", 1))
    if name.startswith(f"{_SESSION}:"):
        return ValueSource(name)
    return ValueSource(name, _digest(file_of(ValueSource(name))))


def kept_source(value: object) -> ValueSource:
    """Return the source of an object: a file, where one defines it by name, or this session.

    A function or class is in a file if its module has it under its own name.
    """
    module = sys.modules.get(getattr(value, "__module__", None) or "")
    name = getattr(value, "__qualname__", "")
    file = getattr(module, "__file__", None)
    if file and file.endswith(".py") and getattr(module, name, None) is value:
        return source_of(f"{file}:{name}")
    key = f"{_SESSION}:value{len(_kept) + 1}"
    _kept[key] = value
    return ValueSource(key)


def builder_source(asked: object) -> ValueSource | None:
    """Return the source of a function or class, given as such or by its name; None of others."""
    if callable(asked):
        return kept_source(asked)
    return source_of(str(asked)) if is_source_name(asked) else None


def named_source(source: ValueSource, is_it: Callable[[object], bool]) -> ValueSource:
    """Return where a file has an object of this session at its top; a source that is in a file
    already stays as it is.

    Raises:
        ValueError: no file has it.
    """
    if not source.name.startswith(f"{_SESSION}:"):
        return source
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None) or ""
        if file.endswith(".py") and not module.__name__.startswith("concord."):
            for name, value in list(vars(module).items()):
                if is_it(value):
                    return source_of(f"{file}:{name}")
    raise ValueError(
        f"{source.name}: only this Python session has this object, and other processes cannot read "
        "it; define it under a name at the top of a .py file"
    )


def value_of(source: ValueSource) -> Any:
    """Return the value of a source; its file is executed once in each process.

    Raises:
        ValueError: no such file, module or name, a file that fails, or one of another digest.
    """
    if source.name.startswith(f"{_SESSION}:"):
        if source.name not in _kept:
            raise ValueError(
                f"{source.name}: only the Python session that made this object has it; define it "
                "at the top of a file, and give it as FILE.py:NAME"
            )
        return _kept[source.name]
    place, _, name = source.name.rpartition(":")
    file = file_of(source)
    digest = _digest(file)
    if source.digest and digest != source.digest:
        raise ValueError(
            f"{source.name}: {file.absolute()} has digest {digest}, and the network runs a file of "
            f"digest {source.digest}; copy that file to this place, or start the network anew"
        )
    module = _module_of(place, file.absolute(), digest)
    if not hasattr(module, name):
        names = [one for one in vars(module) if not one.startswith("_")]
        raise unknown_name(f"name in {place}", name, names or ["(none)"])
    return getattr(module, name)


def function_or(
    wanted: type[Wanted], source: ValueSource, rule: str
) -> Wanted | Callable[..., Any]:
    """Return the value of a source: a function, or an instance of a class; `rule` names both.

    Raises:
        ValueError: as `value_of`, or another value; a class is none of them.
    """
    value = value_of(source)
    if isinstance(value, type) or not (isinstance(value, wanted) or callable(value)):
        raise ValueError(f"{source.name}: it is a {type(value).__name__}; it must be {rule}")
    return value


def file_of(source: ValueSource) -> Path:
    """Return the file of a source.

    Raises:
        ValueError: there is no such file or module.
    """
    name = source.name
    place = name.rpartition(":")[0]
    if place.endswith(".py"):
        file = Path(place)
        if not file.is_file():
            raise ValueError(f"{name}: there is no file {place} in {Path.cwd()}; check the path")
        return file
    try:
        found = importlib.util.find_spec(place)
    except (ImportError, ValueError):
        found = None
    if found is None or not found.origin or not found.origin.endswith(".py"):
        raise ValueError(
            f"{name}: there is no module {place} to import; install it, or give its file as "
            "FILE.py:NAME"
        )
    return Path(found.origin)


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


@lru_cache
def _module_of(place: str, file: Path, digest: str) -> ModuleType:
    """Return the module of a file, executed under a name that no other module has."""
    if not place.endswith(".py"):
        return importlib.import_module(place)
    # A file may import others of its folder; they never hide an installed module.
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    name = f"concord_user_{file.stem}_{digest}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None, "its name ends in .py"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        # Not the loader: it may take compiled code of a former text of this second and length.
        exec(compile(file.read_bytes(), file, "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[name]
        lines = [
            one.lineno
            for one in traceback.extract_tb(error.__traceback__)
            if one.filename == str(file)
        ]
        at = f" line {lines[-1]}" if lines else ""
        raise ValueError(
            f"{place}{at}: {type(error).__name__}: {error}; correct the file"
        ) from error
    return module
