"""Signals of AUTOSAR (ARXML, schema 4): frames, I-PDUs, I-signals, base types, compu methods."""

from collections.abc import Callable, Iterator

from concord.features.flexray_tools.files.arxml import AR, ARXML_FORMAT, element_paths
from concord.features.flexray_tools.files.xml_document import Element
from concord.features.flexray_tools.signals.coding import Coding, NumberType
from concord.features.flexray_tools.signals.described_signals import (
    FoundSignal,
    NoNumber,
    SignalFormat,
    coding_of,
    integer,
    lost,
    real,
    scale_of,
    update_bit,
)

_BIG_ENDIAN, _LITTLE_ENDIAN = "MOST-SIGNIFICANT-BYTE-FIRST", "MOST-SIGNIFICANT-BYTE-LAST"
_NUMBERS: dict[str, NumberType] = {"NONE": "unsigned", "2C": "signed", "IEEE754": "float"}
_PROPERTIES = f"{AR}SW-DATA-DEF-PROPS-VARIANTS/{AR}SW-DATA-DEF-PROPS-CONDITIONAL"


def _signals(root: Element) -> Callable[[str], Iterator[FoundSignal]]:
    named = element_paths(root)

    def signals_of(frame: str) -> Iterator[FoundSignal]:
        element = named.get(frame)
        if element is None:
            return
        for mapping in element.iter(f"{AR}PDU-TO-FRAME-MAPPING"):
            pdu = _referred(mapping, "PDU-REF", named)
            if pdu is None:
                yield lost(f"PDU {mapping.findtext(f'{AR}PDU-REF', '')}", "PDU-REF")
                continue
            start = integer(mapping, f"{AR}START-POSITION", f"PDU in frame {frame!r}")
            for one in pdu.iter(f"{AR}I-SIGNAL-TO-I-PDU-MAPPING"):
                signal = _referred(one, "I-SIGNAL-REF", named)
                name = one.findtext(f"{AR}SHORT-NAME", "?")
                if signal is not None:
                    yield _found(one, signal, start // 8 * 8, named)
                elif one.find(f"{AR}I-SIGNAL-GROUP-REF") is None:
                    yield lost(name, "I-SIGNAL-REF")

    return signals_of


def _found(
    mapping: Element, signal: Element, before: int, named: dict[str, Element]
) -> FoundSignal:
    name = signal.findtext(f"{AR}SHORT-NAME", "").strip()
    order = mapping.findtext(f"{AR}PACKING-BYTE-ORDER", _LITTLE_ENDIAN).strip()
    where = f"signal {name!r}"

    def coding() -> Coding:
        if order not in (_BIG_ENDIAN, _LITTLE_ENDIAN):
            raise NoNumber(f"its byte order is {order}")
        return _coding(signal, name, named)

    return FoundSignal(
        name,
        before + integer(mapping, f"{AR}START-POSITION", where),
        order == _BIG_ENDIAN,
        update_bit(mapping, f"{AR}UPDATE-INDICATION-BIT-POSITION", before, where),
        coding,
    )


def _coding(signal: Element, name: str, named: dict[str, Element]) -> Coding:
    """The I-signal says it, or else its system signal."""
    system = _referred(signal, "SYSTEM-SIGNAL-REF", named)
    owners = [signal.find(f"{AR}NETWORK-REPRESENTATION-PROPS")]
    owners += [] if system is None else [system.find(f"{AR}PHYSICAL-PROPS")]
    said = [one for owner in owners if owner is not None for one in owner.findall(_PROPERTIES)]

    def first(tag: str) -> Element | None:
        found = (_referred(one, tag, named) for one in said)
        return next((one for one in found if one is not None), None)

    base, method = first("BASE-TYPE-REF"), first("COMPU-METHOD-REF")
    encoding = "NONE" if base is None else base.findtext(f"{AR}BASE-TYPE-ENCODING", "NONE").strip()
    if encoding not in _NUMBERS:
        raise NoNumber(f"its base type is coded as {encoding}")
    where = f"signal {name!r}"
    unit = first("UNIT-REF")
    if unit is None and method is not None:
        unit = _referred(method, "UNIT-REF", named)
    invalid = [
        real(one.text, where)
        for owner in said
        for one in owner.findall(f"{AR}INVALID-VALUE/{AR}NUMERICAL-VALUE-SPECIFICATION/{AR}VALUE")
    ]
    return coding_of(
        integer(signal, f"{AR}LENGTH", where),
        _NUMBERS[encoding],
        scale_of(method, AR, where),
        "" if unit is None else unit.findtext(f"{AR}DISPLAY-NAME", "").strip(),
        [(one, one) for one in invalid],
    )


def _referred(element: Element, tag: str, named: dict[str, Element]) -> Element | None:
    return named.get(element.findtext(f"{AR}{tag}", "").strip())


ARXML_SIGNALS = SignalFormat(
    ARXML_FORMAT,
    lambda root: {
        path: path.rpartition("/")[2]
        for path, one in element_paths(root).items()
        if one.tag.endswith("FRAME")
    },
    _signals,
)
