"""Fixed part of a network's picture: everything that its setup determines before the run.

A target is drawn where it is in the plane, a car on its track, and the plant of a scenario with an
`OwnPage` by that. Any other network is laid out by its graph, because its nodes have no place.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from concord.bus.bus import Bus
from concord.entries import member
from concord.nodes.messages import Estimate
from concord.scenarios.build import build_bus
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import with_settings
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.scenario_definition import Score
from concord.scenarios.setup import Setup

SCENE_WIDTH = 20.0
"""Width of the drawn network in units of the scene, whatever it measures in metres."""

_CAR_STATES = ("yaw rate", "side slip", "speed", "heading")


class PlantDrawing(Enum):
    """How a plant is drawn."""

    PLANE = "where it is"
    TRACK = "a car on its track"
    OWN = "as its scenario draws it"
    GRAPH = "the network by its graph"


class StepsTold(Protocol):
    """Takes the steps of a network in order."""

    def add(self, state: np.ndarray, estimates: Mapping[int, Estimate], /) -> tuple[Any, list[str]]:
        """Return what nodes tell beside their beliefs in a step, and words for the log."""
        ...


class OwnPage(NamedTuple):
    """Page of a scenario whose nodes have places, and tell more than a belief.

    Attributes:
        begin: setup -> what takes the steps of a network; each gives a `StepFrame.extra`.
        errors: `StepFrame.extra` -> errors (N,) in place of those of beliefs; NaN of a node that
            told none.
        error_name: name of that error, by which `meanings` and the charts begin.
        belief_unit: unit of the scored states of a belief.
        charts: () -> the charts (`panels.chart.Chart`) in place of that of the RMSE.
        picture: (viser scene, stage) -> the plant (`scene.plants.PlantPicture`), drawn to scale.
        legend: theme -> the marks of that picture (`scene.legend.Meaning`).
        meanings: first words of the titles of `charts`, with the meaning of the chart.
    """

    begin: Callable[[Setup], StepsTold]
    errors: Callable[[Any], np.ndarray]
    error_name: str
    belief_unit: str
    charts: Callable[[], tuple[Any, ...]]
    picture: Callable[..., Any]
    legend: Callable[[Any], list[Any]]
    meanings: Mapping[str, str]


@dataclass(frozen=True)
class Stage:
    """The fixed part of every picture of one run.

    Attributes:
        names: of the nodes. edges: (E, 2), lower index first. heard: (H, 2) receiver, sender of
        each neighbour, in the order in which estimates list ages. layout: (N, 2) of a network
        without places. place: the two states that are a position, empty without. own: what the
        scenario adds to the page.
    """

    setup: Setup
    bus: Bus
    names: tuple[str, ...]
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    edges: NDArray[np.int64]
    heard: NDArray[np.int64]
    score: Score
    set_valued: bool
    picture: PlantDrawing
    place: tuple[int, ...]
    positions: Callable[[int], np.ndarray]
    sight_range_m: float | None
    own: OwnPage | None = None

    @property
    def nodes(self) -> int:
        return self.setup.scenario.nodes

    @property
    def rounds(self) -> int:
        return self.setup.scenario.rounds

    @property
    def deviations(self) -> float:
        """Half-width of the ellipses that are drawn, in standard deviations; of a set its own."""
        return 1.0 if self.set_valued else 3.0

    @property
    def fused_name(self) -> str:
        """Name of the fused belief of all nodes; sets are fused by their enclosing ellipsoids."""
        return "fused ellipsoids" if self.set_valued else "fused"

    @property
    def error_name(self) -> str:
        """Name of the error of a step."""
        return "RMSE" if self.own is None else self.own.error_name

    @cached_property
    def whereabouts(self) -> np.ndarray:
        """Where nodes are in the course of the run (P, 2), in the network's own units."""
        last = max(self.setup.scenario.steps - 1, 0)
        return np.concatenate([self.positions(step) for step in range(0, last + 1, last // 20 + 1)])

    @cached_property
    def centre(self) -> np.ndarray:
        """Middle of the drawn network (2,), in its own units."""
        corners = self.whereabouts
        return (corners.min(0) + corners.max(0)) / 2

    @cached_property
    def scale(self) -> float:
        """Units of the scene per metre (or unit of the layout)."""
        corners = self.whereabouts
        extent = float((corners.max(0) - corners.min(0)).max())
        return SCENE_WIDTH / extent if extent > 0 else 1.0

    def in_plane(self, point: np.ndarray) -> np.ndarray:
        """A point (3,) of the scene as one (2,) of the plane."""
        return point[:2] / self.scale + self.centre

    def in_scene(self, points: np.ndarray, height: float = 0.0) -> np.ndarray:
        """Points (..., 2) of the plane as points (..., 3) of the scene."""
        flat = (points - self.centre) * self.scale
        return np.concatenate([flat, np.full((*flat.shape[:-1], 1), height)], axis=-1)


def set_stage(setup: Setup) -> Stage:
    """Return the stage of a setup."""
    definition = definition_of(setup.scenario)
    plant = definition.plant(setup.scenario)
    positions: Callable[[int], np.ndarray]
    own: OwnPage | None = member(definition.page) if definition.page else None
    if plant.positions(0) is not None:
        picture = PlantDrawing.PLANE if own is None else PlantDrawing.OWN
        positions = _positions(setup)
    else:
        layout = _laid_out(setup.neighbours)
        track = set(_CAR_STATES) <= set(plant.state_names)
        picture, positions = PlantDrawing.TRACK if track else PlantDrawing.GRAPH, lambda _: layout
    edges, heard = _links(setup)
    return Stage(
        setup=setup,
        bus=build_bus(setup),
        names=_names(setup),
        state_names=tuple(plant.state_names),
        state_units=tuple(plant.state_units),
        edges=edges,
        heard=heard,
        score=definition.score,
        set_valued=is_set_valued(setup.scenario),
        picture=picture,
        place=tuple(definition.score.states[:2]) if picture is PlantDrawing.PLANE else (),
        positions=positions,
        sight_range_m=getattr(plant, "field_of_view_m", None),
        own=own,
    )


def restaged(
    stage: Stage, settings: dict[str, Any], first_step: int = 0, first_cycle: int = 0
) -> Stage:
    """Return the stage of a network whose settings have changed from a step on, which begins with
    this cycle; all else stays, also the places of nodes that were laid out by their graph."""
    setup = with_settings(stage.setup, settings)
    bus, (edges, heard) = build_bus(setup, first_step, first_cycle), _links(setup)
    set_valued, positions = is_set_valued(setup.scenario), stage.positions
    if setup.scenario.plant != stage.setup.scenario.plant:
        positions = _positions(setup)
    return replace(
        stage, setup=setup, bus=bus, edges=edges, heard=heard, set_valued=set_valued,
        positions=positions,
    )  # fmt: skip


def _positions(setup: Setup) -> Callable[[int], np.ndarray]:
    """Return where the nodes of a plant with places are: step -> (N, 2) in m."""
    plant = definition_of(setup.scenario).plant(setup.scenario)
    return lambda step: np.asarray(plant.positions(step))


def _links(setup: Setup) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the edges and who hears whom, as a `Stage` has them."""
    heard = [(i, j) for i, neighbours in enumerate(setup.neighbours) for j in neighbours]
    links = sorted({(min(link), max(link)) for link in heard})
    edges, directed = (np.array(ends, dtype=np.int64).reshape(-1, 2) for ends in (links, heard))
    return edges, directed


def _names(setup: Setup) -> tuple[str, ...]:
    names = definition_of(setup.scenario).node_names
    if names:
        return names
    digits = max(2, len(str(setup.scenario.nodes - 1)))
    return tuple(f"{node:0{digits}d}" for node in range(setup.scenario.nodes))


def _laid_out(neighbours: list[list[int]]) -> np.ndarray:
    """A place (N, 2) for each node of a graph; the same for the same graph."""
    import networkx

    graph = networkx.Graph()
    graph.add_nodes_from(range(len(neighbours)))
    graph.add_edges_from((i, j) for i, heard in enumerate(neighbours) for j in heard)
    if len(neighbours) <= 60 and len(neighbours) > 2:
        placed = networkx.kamada_kawai_layout(graph)
    else:
        placed = networkx.spring_layout(graph, seed=1)
    return np.array([placed[node] for node in range(len(neighbours))], dtype=np.float64)
