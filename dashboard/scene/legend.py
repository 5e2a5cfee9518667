"""The marks of the scene with their meaning, for the legend of the page and of pictures."""

from concord.dashboard.frames.conditions import BLIND, DOWN, REJECTED, SEEING, STALE
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import PlantDrawing
from concord.dashboard.scene.signs import MARKS, colour_of
from concord.dashboard.theme import Colour
from concord.dashboard.view import View

_NODES = (
    (SEEING, "node with a reading"),
    (BLIND, "node without a reading (blind)"),
    (STALE, "node that missed the newest share of a neighbour (stale)"),
    (REJECTED, "node that rejected a frame"),
    (DOWN, "node that is down"),
)

Meaning = tuple[str, Colour, str]
"""A sign, its colour, and its meaning in words."""


def meanings(view: View, frame: StepFrame) -> list[Meaning]:
    """Return what the marks of a scene mean; the form of the plant decides which there are."""
    theme, stage = view.theme, frame.stage
    nodes = [(MARKS[word], colour_of(theme, word), words) for word, words in _NODES]
    around = "its set" if stage.set_valued else "three standard deviations"
    plant: dict[PlantDrawing, list[Meaning]] = {
        PlantDrawing.PLANE: [
            ("\u25cf", theme.truth, "truth, with its trail"),
            ("\u25cf", theme.fused, f"{stage.fused_name} belief of all nodes, with its trail"),
            ("\u25cb", theme.estimate, f"belief of a node: an ellipse at {around}"),
            ("\u2014", theme.seeing, "line of sight: the node measures the target in this step"),
        ],
        PlantDrawing.TRACK: [
            ("\u2014", theme.truth, "path of the car"),
            ("\u2014", theme.estimate, "path that a node believes"),
        ],
        PlantDrawing.OWN: [] if stage.own is None else stage.own.legend(theme),
        PlantDrawing.GRAPH: [
            ("\u2588", theme.estimate, "post: the error of a node"),
            ("\u25ef", theme.fused, f"ring: {around}"),
            ("\u2588", theme.down, "post above its ring: overconfident"),
        ],
    }
    links = [
        ("\u25cf", theme.sending, "node that sends, with its links"),
        ("\u2014", theme.edge, "link"),
        ("\u2504", theme.down, "link that is cut"),
    ]
    return [*plant[stage.picture], *nodes, *links]
