"""XML documents that are read, edited and written again with all that they hold.

The standard library parses them. A document type is refused, because entities can be defined there
that fill the memory.
"""

from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from typing import Any, NamedTuple
from xml.etree import ElementTree

from concord.bus.flexray.cluster import ClusterError

Element = ElementTree.Element
_XML = "http://www.w3.org/XML/1998/namespace"
# XML 1.0, 2.4 and 3.3.3. `xml.sax.saxutils` does the same, but loads urllib and ssl for it.
_IN_TEXT = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})
_IN_ATTRIBUTE = _IN_TEXT | str.maketrans(
    {'"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
)


class ClusterFileError(ClusterError):
    """A file that does not describe one valid FlexRay cluster; names the element."""


class XmlDocument(NamedTuple):
    """The root of a document, and the name space of each prefix in it ("" is the default)."""

    root: Element
    spaces: dict[str, str]


class _Builder(ElementTree.TreeBuilder):
    """Builds elements with comments, and keeps the prefixes of name spaces."""

    def __init__(self, format_name: str) -> None:
        super().__init__(insert_comments=True, insert_pis=True)
        self.spaces: dict[str, str] = {}
        self._format_name = format_name

    def start_ns(self, prefix: str, uri: str) -> None:
        self.spaces.setdefault(prefix or "", uri)

    def doctype(self, name: str, pubid: str, system: str) -> None:
        raise ClusterFileError(
            f"the {self._format_name} file declares a document type ({name!r}), in which entities "
            "can be defined that fill the memory; remove the DOCTYPE declaration, "
            f"{self._format_name} needs none"
        )


def parse_document(text: str | bytes, format_name: str) -> XmlDocument:
    """Parse a document.

    Raises:
        ClusterFileError: it is not well-formed, or declares a document type.
    """
    builder = _Builder(format_name)
    try:
        parser = ElementTree.XMLParser(target=builder)
        root = ElementTree.fromstring(text, parser=parser)
    except (ElementTree.ParseError, LookupError, UnicodeError) as error:
        raise ClusterFileError(
            f"the {format_name} file is not well-formed XML: {error}; export it anew"
        ) from error
    return XmlDocument(root, builder.spaces)


def document_text(document: XmlDocument) -> str:
    """Return a document as text, with the prefixes that it came with."""
    prefixes: dict[str, str] = {_XML: "xml"}
    # An attribute needs a prefix, so those go before the default name space.
    for prefix, uri in sorted(document.spaces.items(), reverse=True):
        prefixes.setdefault(uri, prefix)
    declared = "".join(
        f" xmlns{prefix and ':'}{prefix}={_quoted(uri)}" for prefix, uri in document.spaces.items()
    )
    parts = ['<?xml version="1.0" encoding="UTF-8"?>\n']
    parts += _texts(document.root, prefixes, declared)
    return "".join(parts) + "\n"


def _texts(element: Element, prefixes: dict[str, str], declared: str = "") -> Iterator[str]:
    if not isinstance(element.tag, str):
        yield ElementTree.tostring(element, encoding="unicode", short_empty_elements=True)
        return
    name = _qualified(element.tag, prefixes)
    attributes = "".join(
        f" {_qualified(key, prefixes)}={_quoted(value)}" for key, value in element.items()
    )
    if not len(element) and not element.text:
        yield f"<{name}{declared}{attributes}/>"
    else:
        yield f"<{name}{declared}{attributes}>{(element.text or '').translate(_IN_TEXT)}"
        for child in element:
            yield from _texts(child, prefixes)
            # That of a comment is in its own text.
            yield (child.tail or "").translate(_IN_TEXT) if isinstance(child.tag, str) else ""
        yield f"</{name}>"


def _quoted(value: str) -> str:
    return f'"{value.translate(_IN_ATTRIBUTE)}"'


def _qualified(tag: str, prefixes: dict[str, str]) -> str:
    if not tag.startswith("{"):
        return tag
    uri, local = tag[1:].split("}")
    prefix = prefixes[uri]
    return f"{prefix}:{local}" if prefix else local


def add(parent: Element, tag: str, text: object = None, **attributes: str) -> Element:
    """Append an element to a parent and return it."""
    child = ElementTree.SubElement(parent, tag, attributes)
    child.text = None if text is None else str(text)
    return child


def section(parent: Element, tag: str) -> Element:
    """Return the first child of that name, which is added if there is none."""
    found = parent.find(tag)
    return add(parent, tag) if found is None else found


def number(element: Element, tag: str, kind: type[int] | type[float], where: str) -> Any:
    """Return the number in a child element, None where there is none.

    Raises:
        ClusterFileError: it is there with several values, or with none that is a number.
    """
    name = tag.rpartition("}")[2]
    texts = {(child.text or "").strip() for child in element.findall(tag)}
    if not texts:
        return None
    if len(texts) > 1:
        raise ClusterFileError(
            f"{where}: element <{name}> is there several times with different values "
            f"({', '.join(sorted(texts))}); keep one"
        )
    return as_number(texts.pop(), kind, f"{where}: <{name}>")


def as_number(text: str, kind: type[int] | type[float], place: str) -> Any:
    """Return the number that a text says.

    Raises:
        ClusterFileError: it says none.
    """
    words = "a whole number" if kind is int else "a number"
    try:
        value = kind(text)
    except ValueError as error:
        raise ClusterFileError(f"{place} says {text[:40]!r}, but must be {words}") from error
    if not abs(value) < 1e9:
        raise ClusterFileError(f"{place} says {text[:40]!r}, but must be a sensible {words[2:]}")
    return value


def microseconds(seconds: float | str) -> float:
    """Return seconds, as they are printed, in microseconds."""
    return float(Decimal(str(seconds)).scaleb(6))


def in_seconds(time_us: float) -> str:
    """Return microseconds as the seconds that `microseconds` reads back."""
    try:
        return str(Decimal(repr(time_us)).scaleb(-6))
    except InvalidOperation:
        return repr(time_us * 1e-6)
