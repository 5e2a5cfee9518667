"""Test the shares of each fusion rule, and what each rule refuses."""

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from concord.bus.flexray.share_frames import payload_lengths
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_node
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare, share_bytes
from concord.scenarios.rule_table import rules
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types import rules as rule_types
from concord.studies.near_agreement import departures

NEEDS: dict[str, dict] = {
    "centralised": {"graph": "complete", "rounds": 1},
    "trimmed-ci": {"graph": "complete"},
}
FRESH = ("hcmci", "icf", "diffusion", "kcf", "centralised")
# Those that fuse beliefs or information; rules of other kinds have tests of their own.
FUSING = ("ci", "trimmed-ci", "wac", "local", *FRESH)
EACH = pytest.mark.parametrize("rule", FUSING)


def scenario(rule: str, **changes) -> Scenario:
    """A short run of the oscillator under a rule."""
    settings = {"rule": rule, "steps": 6, **NEEDS.get(rule, {}), **changes}
    return definition_named("oscillator").defaults.with_(**settings)


def trace(setup: Setup) -> Trace:
    return read_trace(setup, in_memory(setup))


@EACH
@pytest.mark.parametrize("number", ["float64", "float32"])
def test_every_share_has_the_length_that_the_bus_was_told(rule: str, number: str):
    setup = prepare(scenario(rule, number=number))
    node = build_node(setup, 0)
    content = node.estimator.start()
    lengths = {node.estimator.share_bytes, len(node.estimator.compose(content)[1])}
    assert lengths == {share_bytes(setup)}
    frames = node.bus.encode(0, 0, bytes(share_bytes(setup)))
    assert len(frames) == len(payload_lengths(share_bytes(setup)))


def test_shares_are_as_long_as_their_formulas_say():
    """n = 2 states, N = 8 nodes, 8 bytes a number; a pair is n + n (n + 1) / 2 numbers."""
    expected = {
        "hcmci": 8 * (2 * 5 + 8),
        "kcf": 8 * (5 + 2),
    }
    for rule in FUSING:
        assert share_bytes(prepare(scenario(rule))) == expected.get(rule, 8 * 5)


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", [*FRESH, "local"])
@pytest.mark.parametrize("hold", ["raw", "predict", "drop", "in-step"])
def test_a_hold_policy_that_a_rule_cannot_use_is_refused(rule: str, hold: str):
    with pytest.raises(ValueError, match=f"hold {hold}: belongs to rule ci"):
        prepare(scenario(rule, hold=hold))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"graph": "ring"}, "graph ring: node 0 hears 2 of 7 others.*--graph complete"),
        ({"schedule": "round-robin", "occupancy": 0.5}, "schedule round-robin.*--schedule full"),
        ({"rounds": 2}, "rounds 2.*--rounds 1"),
    ],
)
def test_the_centralised_rule_needs_everybody_at_once(changes: dict, says: str):
    with pytest.raises(ValueError, match=f"rule centralised .*{says}"):
        prepare(scenario("centralised", **changes))


def test_weights_that_miss_the_average_are_refused_where_it_is_multiplied():
    with pytest.raises(ValueError, match=r"rule icf .*column 0 sums to .*rule hcmci"):
        prepare(scenario("icf", graph="star", weights="equal-neighbour"))
    prepare(scenario("hcmci", graph="star", weights="equal-neighbour"))


@EACH
def test_a_network_of_one_is_the_filter_alone(rule: str):
    found = trace(prepare(scenario(rule, nodes=1)))
    alone = trace(prepare(scenario("local", nodes=1)))
    np.testing.assert_allclose(found.mean, alone.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.cov, alone.cov, rtol=0, atol=1e-12)


# --- the page that says how to add one -----------------------------------------------------------


def test_the_example_of_the_page_runs(monkeypatch: pytest.MonkeyPatch):
    page = (Path(__file__).parents[2] / "docs" / "adding_a_filter.md").read_text()
    function, struct, entry = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names = {**vars(rule_types)}
    exec(function, names)
    exec(struct, names)
    assert eval(f"{{{entry}}}", {"_TYPES": ""})["sharpest"][1] == names["Sharpest"].summary()
    monkeypatch.setattr(rules, "chosen", lambda kind, name: names[name])
    usual = scenario("ci", graph="complete", rounds=1, steps=40)
    setup = prepare(structs.replace(usual, rule=names["Sharpest"]()))
    found = trace(setup)
    # Rounding chooses among equally precise beliefs, and so decides the mean.
    assert departures(setup, found).keys() <= {"mean"}
    # Where all nodes hear each other, each belief is as precise as the most precise one.
    size = np.linalg.det(found.cov)
    np.testing.assert_allclose(size, size[:, :1].repeat(8, axis=1), rtol=1e-12)
    alone = trace(prepare(scenario("local", steps=40)))
    assert size[0, 0] == pytest.approx(np.linalg.det(alone.cov[0]).min(), rel=1e-12)
