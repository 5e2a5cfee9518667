"""The page on the state machines shows the diagrams of the tables as they are."""

from concord.nodes import node
from concord.nodes.node_state import Phase
from docs.state_diagram import PAGE, arrows_of, diagrams, drawn


def test_the_page_shows_the_tables():
    page = PAGE.read_text(encoding="utf-8")
    assert all(text in page for text in diagrams().values()), "run `make pictures`"
    assert drawn(page) == page


def test_every_phase_can_be_reached_and_left():
    arrows = set(arrows_of(node.TRANSITIONS, node.COMPLETIONS))
    assert {after for _, _, after in arrows} | {Phase.MEASUREMENT} == set(Phase)
    # `concord.nodes.node_changes.apply` leaves CHANGE; FINISHED is the end.
    assert {before for before, _, _ in arrows} == set(Phase) - {Phase.CHANGE, Phase.FINISHED}
