"""ARXML that concord writes, as a strict reader of AUTOSAR files that is not ours sees it."""

from pathlib import Path

import pytest

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.presets import PRESETS, preset
from concord.features.flexray_tools.files.arxml import arxml_with_slots, cluster_to_arxml

autosar_data = pytest.importorskip("autosar_data", reason="of the development group")
PATHS = {
    "cycle_us": ("CYCLE", 1e6),
    "static_slots": ("NUMBER-OF-STATIC-SLOTS", 1),
    "minislots": ("NUMBER-OF-MINISLOTS", 1),
    "static_payload_words": ("PAYLOAD-LENGTH-STATIC", 1),
}


def slots_on(cluster: Cluster) -> tuple[MessageSlot, ...]:
    first = MessageSlot(frame_id=1, payload_bytes=cluster.static_payload_bytes, node=0)
    second = MessageSlot(
        frame_id=2, payload_bytes=8, node=1, channel=cluster.channels, base_cycle=1, repetition=2
    )
    if not cluster.minislots:
        return first, second
    dynamic = MessageSlot(
        frame_id=cluster.first_dynamic_id, payload_bytes=8, node=1,
        latest_transmission_minislot=cluster.minislots // 2,
    )  # fmt: skip
    return first, second, dynamic


@pytest.mark.parametrize("name", PRESETS)
def test_a_strict_reader_loads_what_is_written(name: str, tmp_path: Path):
    cluster = preset(name)
    slots = slots_on(cluster)
    once = cluster_to_arxml(cluster, slots)
    for text in (once, arxml_with_slots(once, slots[:1])):
        path = tmp_path / "bus.arxml"
        path.write_text(text)
        model = autosar_data.AutosarModel()
        # Strict: an element that the schema lacks, or in a wrong place, is an error.
        _, warnings = model.load_file(str(path), strict=True)
        assert not warnings
        assert not model.check_references()
        found = {
            str(element.element_name): element.character_data
            for _, element in model.elements_dfs
            if element.character_data is not None
        }
        for field, (tag, factor) in PATHS.items():
            assert float(found[tag]) * factor == pytest.approx(getattr(cluster, field))
