"""Network of the Intel lab: links of its file, any number of motes, and folders without them."""

from pathlib import Path

import pytest

from concord.features.recorded.intel_lab import BOTH_WAYS, LEAST_DELIVERY, intel_lab
from concord.scenarios.links import link_state
from concord.scenarios.preparation import prepare
from concord.topology.adjacency import is_symmetric, links_of
from concord.topology.analysis import components
from tests.experiments.support import scenario, small
from tests.test_batched_agreement import check_agreement

LAB = Path(__file__).resolve().parents[4] / "shared/data/intel_lab"
needs_lab = pytest.mark.skipif(not LAB.is_dir(), reason="no ../shared/data/intel_lab to read")


@needs_lab
def test_the_lab_has_the_links_of_its_file():
    lab, both = intel_lab(LAB, one_way=True), intel_lab(LAB)
    assert lab.names == both.names and lab.names is not None
    assert len(lab.names) == 53 and "5" not in lab.names and "0" not in lab.names
    rows = [line.split() for line in (LAB / "connectivity.txt").read_text().splitlines()]
    shares = {(r[0], r[1]): float(r[2]) for r in rows if len(r) == 3}
    hearer, heard = links_of(lab.adjacency)
    assert lab.delivery is not None
    for i, j, share in zip(hearer, heard, lab.delivery, strict=True):
        assert shares[lab.names[j], lab.names[i]] == share >= LEAST_DELIVERY
    assert lab.adjacency.nnz == 969 and both.adjacency.nnz == 802
    assert is_symmetric(both.adjacency) and not is_symmetric(lab.adjacency)
    assert lab.positions is not None and lab.positions[0].tolist() == [21.5, 23]


@needs_lab
@pytest.mark.parametrize("one_way", [False, True])
def test_any_number_of_motes_hangs_together(one_way):
    for nodes in range(1, 54):
        part = intel_lab(LAB, nodes, one_way=one_way)
        assert part.adjacency.shape == (nodes, nodes)
        assert len(components(part.adjacency)) == 1
    with pytest.raises(ValueError, match="53 motes reach each other; ask for 1 to 53"):
        intel_lab(LAB, 54, one_way=one_way)


def test_a_folder_of_something_else_is_no_lab(tmp_path):
    assert not BOTH_WAYS.is_at(tmp_path)
    with pytest.raises(ValueError, match=r"mote_loc\.txt: no such file; name the folder"):
        intel_lab(tmp_path)
    (tmp_path / "mote_loc.txt").write_text("1 0 here\n")
    with pytest.raises(ValueError, match=r"mote_loc\.txt:1: '1 0 here' is no mote"):
        intel_lab(tmp_path)
    (tmp_path / "mote_loc.txt").write_text("1 0 0\n2 1 1\n")
    (tmp_path / "connectivity.txt").write_text("1 2 0.5\n2 1 7\n")
    with pytest.raises(ValueError, match=r"connectivity\.txt:2: '2 1 7' is no link"):
        intel_lab(tmp_path)


@needs_lab
def test_a_scenario_has_the_directed_lossy_links_of_the_lab():
    asked = scenario(
        "oscillator", nodes=12, steps=5, graph=f"intel-lab:{LAB}", links="measured", loss=0.1,
        stretch=100.0,
    )  # fmt: skip
    check_agreement(asked)
    setup = prepare(asked)
    losses = link_state(setup).losses
    assert len(losses) == sum(map(len, setup.neighbours))
    assert min(losses.values()) > 0.1 and max(losses.values()) <= 1 - 0.9 * 0.1 + 1e-12
    assert any(losses[i, j] != losses[j, i] for i, j in losses)


def test_a_lab_without_a_folder_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("CONCORD_INTEL_LAB", raising=False)
    with pytest.raises(ValueError, match="intel-lab:FOLDER, or with"):
        small(graph="intel-lab")
