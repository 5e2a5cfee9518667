"""TOML files of clusters: what is written is read, and mistakes are named."""

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.bus.flexray.cluster_files import cluster_from_toml, cluster_to_toml
from concord.bus.flexray.presets import AUDI, DEMO
from tests.bus.support import clusters, quick

names = st.text(min_size=1).filter(lambda name: name == name.strip() and name.isprintable())


@quick
@given(clusters(), names)
@example(DEMO, 'quote " and \\ back')
def test_any_cluster_and_name_survive_the_round_trip(cluster: Cluster, name: str):
    named = msgspec.structs.replace(cluster, name=name)
    assert cluster_from_toml(cluster_to_toml(named)) == named


def test_the_file_speaks_the_standard_too():
    assert "static_slots = 51  # gNumberOfStaticSlots" in cluster_to_toml(AUDI)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("static_slots = 20", "static_slots = ", "not TOML"),
        ("static_slots = 20", 'static_slots = "20"', "static_slots"),
        ("static_slots = 20", "slots = 20", "slots"),
        ("static_slots = 20", "static_slots = 21", "constraint 18"),
        ("minislots = 550", "minislots = 20000", "gNumberOfMinislots"),
    ],
)
def test_mistakes_are_named(old: str, new: str, said: str):
    text = cluster_to_toml(DEMO)
    assert old in text
    with pytest.raises(ClusterError, match=said):
        cluster_from_toml(text.replace(old, new))


def test_a_missing_field_is_named():
    lines = cluster_to_toml(DEMO).splitlines()
    text = "\n".join(line for line in lines if not line.startswith("minislots"))
    with pytest.raises(ClusterError, match="minislots"):
        cluster_from_toml(text)


@quick
@given(st.text())
def test_any_text_is_refused_politely(text: str):
    with pytest.raises(ClusterError):
        cluster_from_toml(text)
