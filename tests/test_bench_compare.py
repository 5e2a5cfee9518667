"""Test which figures `make bench-compare` calls worse."""

import msgspec
import pytest

from benchmarks import compare
from benchmarks.measure import BenchmarkFigure, Better, figure, in_turns, ratio, table
from benchmarks.picture import draw


def kept(value: float, spread: float, better: Better = "less") -> compare.Kept:
    table = {"one": BenchmarkFigure(value, value - spread, value + spread, "us", better)}
    return compare.Kept({"cpu": "a"}, {"ukf": table})


@pytest.mark.parametrize(
    ("base", "new", "better", "worse"),
    [
        (kept(10, 1), kept(11.5, 1), "less", False),  # the spreads meet
        (kept(10, 1), kept(13, 1), "less", True),
        (kept(10, 0.01), kept(11.9, 0.01), "less", False),  # no more than runs of one code differ
        (kept(10, 0.01), kept(12.5, 0.01), "less", True),
        (kept(10, 3), kept(14, 3), "less", False),
        (kept(10, 1), kept(7, 1), "less", False),
        (kept(10, 1, "more"), kept(7, 1, "more"), "more", True),
        (kept(10, 1, "more"), kept(13, 1, "more"), "more", False),
    ],
)
def test_worse_is_beyond_both_spreads(base, new, better, worse, tmp_path, monkeypatch, capsys):
    for name, value in (("base", base), ("new", new)):
        (tmp_path / name).write_bytes(msgspec.json.encode(value))
    monkeypatch.setattr("sys.argv", ["compare", str(tmp_path / "base"), str(tmp_path / "new")])
    with pytest.raises(SystemExit) as ended:
        compare.main()
    assert ended.value.code == int(worse)
    assert ("WORSE" in capsys.readouterr().out) == worse


def test_a_file_that_is_none_is_refused_in_a_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["compare", str(tmp_path / "a"), str(tmp_path / "b")])
    with pytest.raises(SystemExit) as ended:
        compare.main()
    assert ended.value.code == 2
    assert "cannot read" in capsys.readouterr().err


def test_contestants_take_turns_and_the_first_turn_is_left_out():
    order = []

    def contestant(name, seconds):
        def run():
            order.append(name)
            return seconds[order.count(name) - 1]

        return run

    given = in_turns(
        {"a": contestant("a", [9.0, 2.0, 4.0]), "b": contestant("b", [9.0, 1.0, 1.0])}, 2
    )
    assert order == ["a", "b"] * 3
    assert given == {"a": [2.0, 4.0], "b": [1.0, 1.0]}
    assert ratio(given["a"], given["b"]) == figure([2.0, 4.0], "x", "more")


def test_the_picture_and_the_table_take_what_was_measured(tmp_path):
    scale = {
        f"{nodes} nodes, ns per edge": BenchmarkFigure(500.0, 490.0, 510.0, "ns", "less")
        for nodes in (10, 100)
    }
    slope = BenchmarkFigure(1.0, 1.0, 1.0, "", "less")
    results = {"scale": scale | {"slope": slope}, "lockstep": {"lockstep over bare": slope}}
    draw(results, tmp_path / "some.png")
    assert (tmp_path / "some.png").read_bytes().startswith(b"\x89PNG")
    text = table(results)
    for bench, figures in results.items():
        assert f"\n{bench}\n" in text
        for name in figures:
            assert f"\n  {name} " in text
    assert "490 - 510  ns" in text
