"""Each planted mistake breaks the promises that it must, in a few cases and in this process."""

import pytest

from concord.studies.check import filter_promises, rule_promises
from concord.studies.sweep.workers import in_this_process
from tests.experiments.test_check_filters import MISTAKES as OF_FILTERS
from tests.experiments.test_check_filters import WRONG as FILTERS
from tests.experiments.test_check_rules import ABOUT_BELIEFS
from tests.experiments.test_check_rules import MISTAKES as OF_RULES
from tests.experiments.test_check_rules import WRONG as RULES

OF_MODELS = [one for one in filter_promises.FILTER_PROMISES if one.name != "agreement"]
OF_BELIEFS = [one for one in rule_promises.RULE_PROMISES if one.name in ABOUT_BELIEFS]


@pytest.mark.parametrize("mistake", OF_FILTERS)
def test_a_filter_with_a_mistake_breaks_its_promises(mistake: str):
    checked = filter_promises.checked_filter(f"{FILTERS}:{mistake}", linear=True)
    found = {one.name: one.check(checked, range(1, 9)) for one in OF_MODELS}
    broken = {name for name, one in found.items() if one.status == "BROKEN"}
    assert broken >= OF_FILTERS[mistake] and bool(broken) == bool(OF_FILTERS[mistake])
    for name in broken:
        case = found[name].case
        assert case is not None and f"case {case}" in found[name].seen
        # The same case alone breaks the promise in the same way, of a filter without a memory.
        again = {one.name: one for one in OF_MODELS}[name].check(checked, [case])
        assert again == found[name] or mistake == "remembering"


@pytest.mark.parametrize("name", ["ukf", "ckf", "kf"])
def test_filters_of_concord_keep_their_promises(name: str):
    checked = filter_promises.checked_filter(name, linear=True)
    assert {one.check(checked, range(1, 9)).status for one in OF_MODELS} == {"holds"}


def test_a_filter_that_claims_nothing_about_linear_models_breaks_no_promise_about_them():
    checked = filter_promises.checked_filter(f"{FILTERS}:absolute", linear=False)
    found = {one.name: one.check(checked, range(1, 9)).status for one in OF_MODELS}
    assert found["linear"] == "note" and found["units"] == "BROKEN"


@pytest.mark.parametrize("mistake", OF_RULES)
def test_a_rule_with_a_mistake_breaks_its_promises(mistake: str):
    checked = rule_promises.checked_rule(f"{RULES}:{mistake}", True, in_this_process)
    found = {one.name: one.check(checked, range(1, 13)) for one in OF_BELIEFS}
    broken = {name for name, one in found.items() if one.status == "BROKEN"}
    assert broken - {"units"} == OF_RULES[mistake] - {"units"}
    for name in broken:
        case, values = found[name].case, found[name].values
        assert case is not None and values is not None
        again = {one.name: one for one in OF_BELIEFS}[name].check(checked, [case])
        assert (again.seen, again.values) == (found[name].seen, values)
        size = found[name].seen.partition(":")[0]
        neighbours, states = (int(word.split()[-1]) for word in size.split(", ")[1:])
        assert len(values["weights"]) == neighbours + 1
        assert len(values["mean"]) == states * (neighbours + 1)


def test_a_rule_that_claims_no_consistency_gets_a_note():
    checked = rule_promises.checked_rule(f"{RULES}:overconfidence", False, in_this_process)
    found = {one.name: one.check(checked, range(1, 13)).status for one in OF_BELIEFS}
    assert found["consistent"] == "note"


def test_a_rule_of_concord_keeps_its_promises_on_lossy_networks_too():
    checked = rule_promises.checked_rule("ci", True, in_this_process)
    some = [one for one in rule_promises.RULE_PROMISES if one.name != "agreement"]
    found = {one.name: one.check(checked, range(1, 4)) for one in some}
    assert {name: one.seen for name, one in found.items() if one.status != "holds"} == {}
    assert found["loss"].seen == "3 runs, finite beliefs"


def test_a_rule_that_exchanges_no_beliefs_has_no_promises_about_them():
    checked = rule_promises.checked_rule("labelled", True, in_this_process)
    assert {one.check(checked, [1]).status for one in OF_BELIEFS} == {"skipped"}
