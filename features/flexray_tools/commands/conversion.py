"""`concord flexray convert`: a cluster and its slot table in another format."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import tyro

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_files import cluster_to_toml, file_endings
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.slot_file import SlotFileError, read_slot_file, slots_to_toml
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.commands.clusters import read_cluster, write_new
from concord.features.flexray_tools.files.arxml import WITHOUT_ELEMENT as NOT_IN_ARXML
from concord.features.flexray_tools.files.arxml import arxml_with_slots, cluster_to_arxml
from concord.features.flexray_tools.files.exchange import without_element
from concord.features.flexray_tools.files.fibex import WITHOUT_ELEMENT as NOT_IN_FIBEX
from concord.features.flexray_tools.files.fibex import cluster_to_fibex, fibex_with_slots
from concord.features.flexray_tools.files.xml_document import document_text, parse_document


class _Format(NamedTuple):
    """An exchange format: its name, its writers, and the fields that it has no element for."""

    name: str
    write: Callable[[Cluster, Sequence[MessageSlot]], str]
    with_slots: Callable[[bytes, Sequence[MessageSlot], str | None], str]
    lacking: tuple[str, ...]


_FORMATS = {
    ".xml": _Format("FIBEX", cluster_to_fibex, fibex_with_slots, NOT_IN_FIBEX),
    ".arxml": _Format("AUTOSAR", cluster_to_arxml, arxml_with_slots, NOT_IN_ARXML),
}


def convert(
    source: tyro.conf.Positional[str],
    target: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TARGET")],
    /,
    *,
    name: str | None = None,
    slots: Path | None = None,
    slots_out: Path | None = None,
    json: bool = False,
) -> None:
    """Write a cluster and its slot table as TOML (.toml), FIBEX (.xml) or AUTOSAR (.arxml); what
    TARGET is called decides.

    From a file to the same format everything is kept, known or not.

    Args:
        source: A preset, or a file: TOML, FIBEX (.xml) or AUTOSAR (.arxml).
        target: The file to write. It must not exist.
        name: Which cluster of a FIBEX or AUTOSAR file that has several.
        slots: Slot table for TARGET (FIBEX, AUTOSAR). Otherwise that of SOURCE.
        slots_out: Slot table (.toml) of SOURCE to write.
        json: Print one JSON object.
    """
    with user_errors():
        paths = (Path(source), target, slots, slots_out)
        cluster, table, text, left_out = _converted(source, name, *paths)
        if slots_out is not None:
            if not table:
                raise ValueError(f"--slots-out {slots_out}: {source} has no slot table; leave out")
            write_new(slots_out, slots_to_toml(table))
        elif target.suffix == ".toml" and table:
            left_out += [f"{len(table)} slots (--slots-out FILE.toml writes them)"]
        write_new(target, text)
    if json:
        result = {
            "cluster": cluster, "target": str(target), "slots": len(table), "left_out": left_out
        }  # fmt: skip
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    beside = f" with {len(table)} slots" if table and target.suffix in _FORMATS else ""
    sys.stdout.write(f"cluster {cluster.name} of {source} is in {target}{beside}\n")
    if left_out:
        kind = _FORMATS[target.suffix].name if target.suffix in _FORMATS else "a cluster file"
        sys.stdout.write(f"left out, {kind} has no element for it: {', '.join(left_out)}\n")


def _converted(
    source: str,
    name: str | None,
    path: Path,
    target: Path,
    slots: Path | None,
    slots_out: Path | None,
) -> tuple[Cluster, tuple[MessageSlot, ...], str, list[str]]:
    """Return the cluster and the slots of a source, the text of the target, and what it lacks.

    Raises:
        ValueError: a file cannot be read, or its name tells no format.
    """
    if target.suffix not in file_endings():
        raise ValueError(
            f"{target}: cannot tell the format; call it *.toml, *.xml (FIBEX) or *.arxml (AUTOSAR)"
        )
    cluster = read_cluster(source, name)
    table: tuple[MessageSlot, ...] = ()
    if slots is not None:
        table = read_slot_file(slots, cluster)
    elif path.suffix in _FORMATS and path.is_file():
        try:
            table = read_slot_file(path, cluster)
        except SlotFileError as error:
            # A cluster without its slots is worth having.
            if target.suffix != ".toml" or slots_out is not None:
                raise
            return cluster, (), cluster_to_toml(cluster), [f"its slots ({error})"]
    if target.suffix == ".toml":
        return cluster, table, cluster_to_toml(cluster), []
    form = _FORMATS[target.suffix]
    if path.suffix == target.suffix:
        # The slots of the source are in its text already.
        data = path.read_bytes()
        text = form.with_slots(data, table, name) if slots is not None else _text(data)
        return cluster, table, text, list(without_element(table))
    lacking = [field for field in form.lacking if getattr(cluster, field) is not None]
    return cluster, table, form.write(cluster, table), [*lacking, *without_element(table)]


def _text(data: bytes) -> str:
    """Return a document in this program's encoding, with all that it holds."""
    return document_text(parse_document(data, "XML"))
