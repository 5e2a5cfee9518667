"""The settings of a live network: what there is to choose from."""

from concord.dashboard.panels.network_controls import rules_beside


def test_a_rule_of_a_users_file_is_among_the_choices():
    assert "./mine.py:rule" in rules_beside("./mine.py:rule")
    assert rules_beside("ci").count("ci") == 1
