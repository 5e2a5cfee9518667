"""Networks with a liar: what a plain rule makes of it, and one that expects it."""

import numpy as np
import pytest

from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from concord.scenarios.warnings import warnings_of
from tests.experiments.support import scenario

NODES, FROM_STEP, STEPS = 7, 8, 24
LIARS = (3, 5)


def error_m(rule: str, *changes: str, liars: int = 1) -> float:
    """The worst honest node's RMSE of position in m after the lies have begun."""
    expected = {"liars": liars} if rule == "trimmed-ci" else {}
    setup = prepare(
        scenario(
            "target-tracking", rule=rule, graph="complete", nodes=NODES, steps=STEPS,
            changes=changes, **expected,
        )
    )  # fmt: skip
    trace = read_trace(setup, in_memory(setup))
    honest = [node for node in range(NODES) if node not in LIARS]
    off = trace.mean[FROM_STEP + 5 :, honest, :2] - trace.truth[FROM_STEP + 5 :, None, :2]
    return float(np.sqrt(np.square(off).sum(axis=-1).mean(axis=0)).max())


def lies(size: float, inverse_volume: float, *liars: int) -> list[str]:
    return [f"{FROM_STEP} lie {liar} {size:g} {inverse_volume:g}" for liar in liars]


@pytest.mark.slow
def test_as_many_liars_as_were_said_do_not_drag_it_away_and_one_more_does():
    plain = error_m("ci")
    assert error_m("ci", *lies(20, 100, 3)) > 10 * plain
    for size, inverse_volume in ((20, 100), (-1, 4), (1000, 1)):
        assert error_m("trimmed-ci", *lies(size, inverse_volume, 3)) < 2.5 * plain
    # Two that say the same are the worst that two can do.
    assert error_m("trimmed-ci", *lies(5, 100, *LIARS), liars=2) < 2.5 * plain
    assert error_m("trimmed-ci", *lies(5, 100, *LIARS), liars=1) > 10 * plain
    # The cost of the rule without liars.
    assert error_m("trimmed-ci") < 2.5 * plain


def test_a_graph_on_which_nobody_could_tell_is_refused_and_a_thin_one_warned_of():
    with pytest.raises(ValueError, match=r"node 0 hears 2 neighbours and must hear 4"):
        prepare(scenario(rule="trimmed-ci", graph="ring", liars=2))
    with pytest.raises(ValueError, match="liars -1: must be 0 or more"):
        prepare(scenario(rule="trimmed-ci", graph="complete", liars=-1))
    thin = warnings_of(prepare(scenario(rule="trimmed-ci", graph="ring", nodes=8)))
    assert any("is not 3-robust" in line for line in thin)
    assert not warnings_of(prepare(scenario(rule="trimmed-ci", graph="complete", nodes=8)))
