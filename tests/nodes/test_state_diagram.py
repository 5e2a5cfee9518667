"""The page on the state machines shows the diagrams of the tables as they are."""

from docs.state_diagram import PAGE, arrows_of, diagrams, drawn
from nodes import node
from nodes.node_state import Phase


def test_the_page_shows_the_tables():
    page = PAGE.read_text(encoding="utf-8")
    assert all(text in page for text in diagrams().values()), "run `make docs`"
    assert drawn(page) == page


def test_every_phase_can_be_reached_and_left():
    arrows = set(arrows_of(node.TRANSITIONS, node.COMPLETIONS))
    assert {after for _, _, after in arrows} | {Phase.MEASUREMENT} == set(Phase)
    # `nodes.node_changes.apply` leaves CHANGE; FINISHED is the end.
    assert {before for before, _, _ in arrows} == set(Phase) - {Phase.CHANGE, Phase.FINISHED}
