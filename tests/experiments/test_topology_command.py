"""`concord topology`: what it prints is what theory says."""

from pathlib import Path

import numpy as np
import pytest

from concord.scenarios.observability import observability, rank
from concord.studies.topology.convergence import convergence
from concord.studies.topology.report import lines, losses_of, report_of, suspects
from concord.studies.topology.subject import SubjectOptions, subject_of
from concord.topology.analysis import analyse
from concord.topology.graph_files import read_network
from tests.experiments.command_support import concord
from tests.experiments.support import small

LAB = Path(__file__).resolve().parents[3] / "shared/data/intel_lab"


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)

    def run(arguments: str) -> dict:
        return concord(capsys, "topology", *arguments.split(), "--json").json()

    return run


@pytest.mark.slow
@pytest.mark.skipif(not LAB.is_dir(), reason="no ../shared/data/intel_lab to read")
def test_the_lab_converges_as_predicted(answer):
    report = answer(f"analyse {LAB} --seed 3")
    found = report["convergence"]
    assert report["analysis"]["nodes"] == 53 and report["analysis"]["directed"]
    assert found["difference_percent"] < 5 and found["rate_difference_percent"] < 5
    assert abs(found["measured"] / found["predicted"] - 1) < 0.05
    assert len(report["losses"]) == 53


@pytest.mark.parametrize(
    ("source", "links"),
    [("ring", "static"), ("star", "bernoulli:0.3"), ("", "switching:ring,path:3")],
)
def test_predicted_and_measured_rates_agree(source: str, links: str):
    subject = subject_of(source, SubjectOptions(nodes=9, links=links))
    found = convergence(subject, seed=4)
    assert found.rate_difference_percent is not None and found.rate_difference_percent < 5


def test_failures_with_memory_are_slower_than_as_many_without():
    """Markov links that stay down cost more; with failure + repair = 1 they have no memory."""
    forgetful = convergence(subject_of("ring", SubjectOptions(nodes=8, links="markov:0.3,0.7")), 1)
    plain = convergence(subject_of("ring", SubjectOptions(nodes=8, links="bernoulli:0.3")), 1)
    lasting = convergence(subject_of("ring", SubjectOptions(nodes=8, links="markov:0.03,0.07")), 1)
    assert plain.predicted is not None and forgetful.predicted is None
    assert np.log(forgetful.measured) == pytest.approx(np.log(plain.predicted), rel=0.05)
    assert lasting.measured > plain.predicted + 0.01


def test_the_hub_of_a_star_hurts_most_and_nobody_in_a_ring_more_than_another(answer):
    star = answer("analyse star --nodes 7")
    assert star["losses"][0] == {"node": "0", "pieces": 6, "factor": None, "error_growth": None}
    assert star["analysis"]["cut_nodes"] == [0] and len(star["analysis"]["cut_links"]) == 6
    ring = answer("analyse ring --nodes 7")
    assert [loss["node"] for loss in ring["losses"]] == [str(node) for node in range(7)]


def test_of_a_large_network_those_are_taken_away_that_are_likely_to_hurt(tmp_path: Path):
    """Two crowds, of which a single node hears both; and one in a crowd that twenty hear."""
    middle = 900
    links = [(i, (i + hop) % middle) for i in range(middle) for hop in (1, 2)]
    links += [(middle + i, middle + j) for i, j in links] + [(1800, 5), (1800, 1795)]
    links += [(100, other) for other in range(200, 216)]
    (tmp_path / "crowds.edges").write_text("".join(f"{i} {j}\n" for i, j in links))
    subject = subject_of(str(tmp_path / "crowds.edges"), SubjectOptions())
    chosen = suspects(subject, analyse(subject.network.adjacency, subject.weights).cut_nodes, None)
    assert len(chosen) == losses_of(1801) == 200_000 // 1801
    assert {5, 100, 1795, 1800} < set(chosen)
    seeing = np.zeros((1801, 2, 2))
    seeing[777] = np.eye(2)
    assert 777 in suspects(subject, (), seeing)
    assert losses_of(1) == 0 and losses_of(150) == 150 and losses_of(10_000) == 20


@pytest.mark.slow
def test_what_is_measured_too_early_is_told():
    early = convergence(subject_of("path", SubjectOptions(nodes=500)), seed=4)
    assert early.rounds < early.rounds_to_settle and early.rate_difference_percent is not None
    settled = convergence(subject_of("path", SubjectOptions(nodes=9)), seed=4)
    assert settled.rounds >= settled.rounds_to_settle


def test_what_is_seen_of_a_plant_is_what_theory_says():
    """../shared/spec/consensus.md section 1: all plants are observable from their controlled
    output; pitch is not from pitch rate or angle of attack alone."""
    for name, expected in (
        ("aircraft-pitch", [3, 2, 2, 0, 2, 2, 3, 0]),
        ("dc-motor-position", [3, 2, 2, 0, 2, 2, 3, 0]),
        ("suspension", [4, 4, 4, 0, 4, 4, 4, 0]),
    ):
        found = observability(small(name, nodes=8, steps=60))
        joint = found.gramian.sum(axis=0)
        assert [rank(own, joint) for own in found.gramian] == expected
        assert found.blind == (3, 7)


def test_a_scenario_is_analysed_with_its_plant(answer):
    report = answer("analyse --scenario oscillator --nodes 5")
    seen = report["observability"]
    assert seen["joint_rank"] == 2 and seen["states"] == ["x", "vx"]
    assert all(loss["error_growth"] >= 1 - 1e-9 for loss in report["losses"])


def test_a_comparison_has_intervals_where_graphs_are_random(answer):
    rows = answer(
        "compare ring geometric --nodes 10 --weights metropolis,maximum-degree --seeds 4"
    )["rows"]
    assert [(row["graph"], row["graphs"]) for row in rows] == [
        ("ring", 1), ("ring", 1), ("geometric", 4), ("geometric", 4),
    ]  # fmt: skip
    factor = rows[2]["factor"]
    assert factor["low"] < factor["mean"] < factor["high"]
    assert rows[0]["factor"]["low"] == rows[0]["factor"]["high"]


def test_no_interval_of_a_family_reaches_below_zero(answer):
    """Two seeds leave the number of cut nodes and the gap uncertain; neither can be negative."""
    rows = answer("compare scale-free erdos-renyi geometric --nodes 14 --seeds 2")["rows"]
    spreads = [one for row in rows for one in row.values() if isinstance(one, dict)]
    wide = [one for one in spreads if one["mean"] and one["high"] > 2 * one["mean"]]
    assert wide and all(one["low"] > 0 for one in wide)
    for one in wide:
        assert one["low"] * one["high"] == pytest.approx(one["mean"] ** 2)


@pytest.mark.parametrize("suffix", [".graphml", ".edges", ".csv"])
def test_a_generated_graph_is_read_back(answer, tmp_path: Path, suffix: str):
    written = answer(f"generate small-world --nodes 12 --seed 5 -o net{suffix}")
    network = read_network(tmp_path / f"net{suffix}")
    assert network.adjacency.nnz == written["links"] == 48
    report = answer(f"analyse net{suffix}")
    assert report["analysis"]["links"] == 24


def test_parts_without_a_way_between_them_are_only_counted(tmp_path: Path):
    (tmp_path / "apart.edges").write_text("0 1\n2 3\n")
    (tmp_path / "way.csv").write_text("0,1\n0,0\n")
    apart, way = (
        lines(report_of(subject_of(str(tmp_path / name), SubjectOptions()), 1))
        for name in ("apart.edges", "way.csv")
    )
    assert "not connected: 2 parts" in apart
    assert "not connected: 2 parts, joined only by links that go one way" in way


def test_a_report_says_how_a_file_was_read(answer, tmp_path: Path):
    (tmp_path / "lengths.edges").write_text("0 1 12.5\n1 2 3.5\n2 0 7\n")
    report = answer("analyse lengths.edges")
    assert len(report["notes"]) == 1 and "(3.5 to 12.5) are not used" in report["notes"][0]


@pytest.mark.parametrize("suffix", [".png", pytest.param(".svg", marks=pytest.mark.slow)])
def test_pictures_are_drawn(answer, tmp_path: Path, suffix: str):
    for source in ("ring --nodes 6", "geometric --nodes 9", "--scenario target-tracking"):
        name = f"{len(list(tmp_path.iterdir()))}{suffix}"
        drawn = answer(f"show {source} --out {name}")
        assert drawn["file"] == name
        assert (tmp_path / name).stat().st_size > 5000
