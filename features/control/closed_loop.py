"""A plant driven by its controller from the true state, and the figures of its response."""

from typing import Any, NamedTuple, Protocol

import numpy as np

from concord.plants.linear import LinearPlant
from concord.plants.placement import Draws


class Controller(Protocol):
    """Interface between `closed_loop` and a controller; see controllers.py."""

    @property
    def initial_memory(self) -> np.ndarray: ...

    def reference(self, step: int) -> np.ndarray: ...

    def control(
        self, state_estimate: np.ndarray, memory: np.ndarray, step: int
    ) -> tuple[np.ndarray, np.ndarray]: ...


class Response(NamedTuple):
    """states (steps, n), controls (steps, p), references (steps, r), delivered.

    delivered: (steps, nodes, 1, d); controls[k] acts on states[k] until step k + 1.
    """

    states: np.ndarray
    controls: np.ndarray
    references: np.ndarray
    delivered: np.ndarray


class StepFigures(NamedTuple):
    """Rise 10-90 %, last time outside 2 %, overshoot in percent of the step, peak of |output|."""

    rise_time_s: float
    settling_time_s: float
    overshoot_percent: float
    peak: float


def quiet(plant: LinearPlant, steps: int) -> Draws:
    """Draws of zeros: the plant without any noise."""
    nodes, outputs = plant.sensors.noise_std.shape
    n, q = plant.noise_factor.shape
    return Draws(np.zeros(n), np.zeros((steps, q)), np.zeros((steps, nodes, 1, outputs)))


def closed_loop(plant: LinearPlant, controller: Controller, draws: Draws) -> Response:
    """Run the loop for as many steps as there are draws."""
    state, _, _ = plant.initial(draws.initial)
    memory = controller.initial_memory
    rows = []
    for step, (noise, watching) in enumerate(zip(draws.process, draws.measurement, strict=True)):
        delivered = plant.observe(state, watching, step)
        control, memory = controller.control(state, memory, step)
        rows.append((state, control, controller.reference(step), delivered))
        state = plant.advance(state, control, noise, step)
    return Response(*(np.stack(column) for column in zip(*rows, strict=True)))


def step_figures(output: np.ndarray, time_step_s: float, final: float) -> StepFigures:
    """Figures of a response (steps,) to a step that starts at 0 and should end at `final`."""
    import control

    times = time_step_s * np.arange(len(output))
    info: Any = control.step_info(output, timepts=times, final_output=final)
    return StepFigures(
        float(info["RiseTime"]),
        float(info["SettlingTime"]),
        float(info["Overshoot"]),
        float(info["Peak"]),
    )
