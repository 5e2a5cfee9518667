"""The scenarios by name, each as the functions that make its parts."""

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from nodes.belief_consensus import Model, Sensor
from scenarios.scenario import Scenario
from topology.names import unknown_name

if TYPE_CHECKING:
    from bus.schedule import Schedule
    from filters.gaussian import Gaussian
    from filters.sigma_points import SigmaPointRule
    from nodes.estimator import Estimator
    from nodes.world import Delivery
    from scenarios.estimators import Seat
    from scenarios.setup import Setup

Array = NDArray[np.float64]


class ScenarioPlant(Protocol):
    """A plant as a scenario needs it; see `nodes.world.Plant` for what the world needs."""

    @property
    def time_step_s(self) -> float: ...

    @property
    def state_names(self) -> tuple[str, ...]: ...

    @property
    def state_units(self) -> tuple[str, ...]: ...

    def draw(self, generator_for: Callable[[str, int], np.random.Generator], steps: int) -> Any: ...

    def initial(self, noise: Array) -> tuple[Array, Array, Array]: ...

    def advance(self, state: Array, control: Array | None, noise: Array, step: int) -> Array: ...

    def observe(self, state: Array, noise: Array, step: int) -> Array: ...

    def positions(self, step: int) -> Array | None: ...


class ControlLaw(Protocol):
    """A controller: `control(state_estimate (n,), memory, step) -> (control (p,), memory)`."""

    @property
    def initial_memory(self) -> Array: ...

    def control(self, state_estimate: Array, memory: Array, step: int) -> tuple[Array, Array]: ...


class Score(NamedTuple):
    """What errors are measured on: `states` for RMSE (in `unit`), `nees_states` for consistency.

    Scored from `first_step` on, but not before anybody has seen anything; where `near_s` is given,
    also for the steps at most that long after a reading by any node.
    """

    states: tuple[int, ...]
    unit: str
    nees_states: tuple[int, ...]
    first_step: int
    near_s: float | None = None


class Wiring(NamedTuple):
    """What a network is made of in which not every node filters and fuses.

    Attributes:
        schedule: who may publish in which cycle.
        share_bytes: length of a share.
        estimator: that of a node.
        names: what the options rule, schedule and hold may be here.
        warnings: what a user must be told before trusting it.
    """

    schedule: "Callable[[Scenario], Schedule]"
    share_bytes: Callable[[Scenario], int]
    estimator: "Callable[[Setup, int], Estimator]"
    names: dict[str, tuple[str, ...]]
    warnings: Callable[[Scenario], tuple[str, ...]]


class Kind(NamedTuple):
    """One named scenario.

    Attributes:
        summary: one line for `concord list`.
        defaults: the scenario when nothing is asked for.
        check: raises ValueError for what this scenario cannot be.
        plant, model: of a scenario.
        sensor: of a scenario and a node; None for a blind node.
        sensors: those of all nodes as one value whose arrays have the nodes' axis; None where they
            are too unlike for that.
        score: how its errors are measured.
        controller: of a scenario, None where nothing drives the plant.
        warnings: what a user must be told of the plant before a run.
        radio_range_m: reach of a node in the geometric graph, for plants that have positions.
        all_steps: how many steps recorded data hold; None where any number will do.
        points: the sigma-point rule of the filters, None for that of the house.
        wiring: of a network in which not every node filters and fuses.
        delivery: what lies between sensors and their nodes, None where readings arrive as taken.
        listen: (setup, nodes, readings (steps, N, r, d)) -> beliefs (steps,) of one filter that
            takes the readings of these nodes; None for the one that model and sensors give.
        around: what a node puts around its rule's estimator, None for nothing.
        own: fields of `Scenario` that mean something here and not in every scenario.
    """

    summary: str
    defaults: Scenario
    check: Callable[[Scenario], None]
    plant: Callable[[Scenario], ScenarioPlant]
    model: Callable[[Scenario], Model]
    sensor: Callable[[Scenario, int], Sensor | None]
    score: Score
    controller: Callable[[Scenario], ControlLaw | None] = lambda _: None
    warnings: Callable[[Scenario], tuple[str, ...]] = lambda _: ()
    radio_range_m: float | None = None
    all_steps: Callable[[Scenario], int] | None = None
    points: "Callable[[Scenario], SigmaPointRule] | None" = None
    wiring: Wiring | None = None
    delivery: "Callable[[Scenario], Delivery] | None" = None
    listen: "Callable[[Setup, Sequence[int], Array], Gaussian] | None" = None
    around: "Callable[[Scenario, Seat, Estimator], Estimator] | None" = None
    sensors: Callable[[Scenario], Sensor] | None = None
    own: tuple[str, ...] = ()


def kinds() -> dict[str, Kind]:
    """All scenarios by name."""
    from scenarios import (
        control,
        liu2021_network,
        meng2025,
        meng2025_network,
        mrclam,
        oscillator,
        target_tracking,
        vehicle_network,
    )

    return {
        "target-tracking": target_tracking.TURNING,
        "target-crossing": target_tracking.CROSSING,
        "oscillator": oscillator.KIND,
        "mrclam": mrclam.KIND,
        **control.KINDS,
        "meng2025": meng2025.KIND,
        "meng2025-network": meng2025_network.KIND,
        "liu2021-network": liu2021_network.KIND,
        "vehicle-network": vehicle_network.KIND,
    }


def kind_of(name: str) -> Kind:
    """The scenario of that name.

    Raises:
        ValueError: there is none.
    """
    known = kinds()
    if name not in known:
        raise unknown_name("scenario", name, known)
    return known[name]


def check_own(name: str, asked: Iterable[str]) -> None:
    """Refuse fields of other scenarios, which would change nothing here.

    Raises:
        ValueError: naming the option, the scenario and those that have it.
    """
    for field in asked:
        having = [other for other, kind in kinds().items() if field in kind.own]
        if having and name not in having:
            raise ValueError(
                f"--{field.replace('_', '-')} with --scenario {name}: it is an option of "
                f"{', '.join(having)} alone; leave it out, or choose one of these"
            )
