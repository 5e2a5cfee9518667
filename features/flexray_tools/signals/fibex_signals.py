"""Signals of FIBEX (ASAM MCD-2 NET, versions 2 to 4): frames, PDUs, signal instances, codings."""

from collections.abc import Callable, Iterator

from concord.features.flexray_tools.files.fibex import FIBEX_FORMAT, FX, HO
from concord.features.flexray_tools.files.xml_document import Element
from concord.features.flexray_tools.signals.coding import Coding, NumberType
from concord.features.flexray_tools.signals.described_signals import (
    FoundSignal,
    NoNumber,
    SignalFormat,
    coding_of,
    integer,
    lost,
    scale_of,
    span_of,
    update_bit,
)

_NUMBERS: dict[str, NumberType] = {"A_UINT": "unsigned", "A_INT": "signed", "A_FLOAT": "float"}


def _signals(root: Element) -> Callable[[str], Iterator[FoundSignal]]:
    named = {one.get("ID", ""): one for one in root.iter() if one.get("ID")}

    def signals_of(frame: str) -> Iterator[FoundSignal]:
        element = named.get(frame)
        if element is None:
            return
        yield from _instances(element, 0, named)
        for instance in element.iter(f"{FX}PDU-INSTANCE"):
            pdu = named.get(_reference(instance, "PDU-REF"))
            if pdu is None:
                yield lost(f"PDU {_reference(instance, 'PDU-REF')}", "PDU-REF")
            else:
                where = f"PDU instance in frame {frame!r}"
                yield from _instances(
                    pdu, integer(instance, f"{FX}BIT-POSITION", where) // 8 * 8, named
                )

    return signals_of


def _instances(owner: Element, before: int, named: dict[str, Element]) -> Iterator[FoundSignal]:
    """Yield the signals of a PDU or a frame, so many bits after the beginning of the payload."""
    for instance in owner.findall(f"{FX}SIGNAL-INSTANCES/{FX}SIGNAL-INSTANCE"):
        signal = named.get(_reference(instance, "SIGNAL-REF"))
        if signal is None:
            yield lost(_reference(instance, "SIGNAL-REF"), "SIGNAL-REF")
            continue
        name = signal.findtext(f"{HO}SHORT-NAME", "").strip() or signal.get("ID", "?")
        where = f"signal {name!r}"
        yield FoundSignal(
            name,
            before + integer(instance, f"{FX}BIT-POSITION", where),
            instance.findtext(f"{FX}IS-HIGH-LOW-BYTE-ORDER", "").strip().lower() in ("true", "1"),
            update_bit(instance, f"{FX}SIGNAL-UPDATE-BIT-POSITION", before, where),
            lambda signal=signal, name=name: _coding(signal, name, named),
        )


def _coding(signal: Element, name: str, named: dict[str, Element]) -> Coding:
    coding = named.get(_reference(signal, "CODING-REF"))
    coded = None if coding is None else coding.find(f"{HO}CODED-TYPE")
    if coding is None or coded is None:
        raise NoNumber("it has no coding")
    base = coded.get(f"{HO}BASE-DATA-TYPE", "A_UINT")
    kind: NumberType | None = next(
        (k for start, k in _NUMBERS.items() if base.startswith(start)), None
    )
    encoding = coded.get(f"{HO}ENCODING", "").upper()
    if kind is None or encoding in ("1C", "SM", "BCD-P", "BCD-UP"):
        raise NoNumber(f"it is of type {base} {encoding}".strip())
    if encoding in ("SIGNED", "2C") and kind != "float":
        kind = "signed"
    where = f"signal {name!r}"
    methods = coding.findall(f"{HO}COMPU-METHODS/{HO}COMPU-METHOD")
    if len(methods) > 1:
        raise NoNumber(f"its coding has {len(methods)} methods")
    method = methods[0] if methods else None
    unit = named.get("" if method is None else _reference(method, "UNIT-REF", HO))
    return coding_of(
        integer(coded, f"{HO}BIT-LENGTH", where),
        kind,
        scale_of(method, HO, where),
        "" if unit is None else unit.findtext(f"{HO}DISPLAY-NAME", "").strip(),
        _invalid(coding, where),
    )


def _invalid(coding: Element, where: str) -> list[tuple[float, float]]:
    """The spans of raw numbers that are not valid."""
    return [
        span_of(one, HO, where)
        for constraints in coding.iter(f"{HO}INTERNAL-CONSTRS")
        for one in constraints.iter(f"{HO}SCALE-CONSTR")
        if one.get("VALIDITY", "VALID") != "VALID"
    ]


def _reference(element: Element, tag: str, space: str = FX) -> str:
    found = element.find(f"{space}{tag}")
    return "" if found is None else found.get("ID-REF", "")


FIBEX_SIGNALS = SignalFormat(
    FIBEX_FORMAT,
    lambda root: {
        one.get("ID", ""): one.findtext(f"{HO}SHORT-NAME", "").strip() or one.get("ID", "")
        for one in root.iter(f"{FX}FRAME")
    },
    _signals,
)
