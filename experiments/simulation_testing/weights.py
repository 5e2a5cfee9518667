"""The weights that a hold policy promises, worked out number by number."""

import numpy as np

from concord.scenarios.scenario import Scenario
from concord.scenarios.types.holds import Dropped, Fading, InStep, Renormalised
from concord.scenarios.types.rules import hold_of


def promised_weights(
    scenario: Scenario,
    base: np.ndarray,
    ages: np.ndarray,
    inverse_volume: np.ndarray,
    cycles_in_step: int,
) -> list[float]:
    """Weights (J,) of a node's own belief and of those that it holds, of these ages in cycles."""
    hold = hold_of(scenario.rule) or Renormalised()

    def worth(weight: float, age: int, sharp: float) -> float:
        if age < 0:
            return 0.0
        match hold:
            case Fading(decay=decay):
                return weight * decay**age * sharp
            case Dropped() | Renormalised():
                return weight if age == 0 else 0.0
            case InStep():
                return weight if age <= cycles_in_step else 0.0
        return weight

    worths = [
        worth(*one)
        for one in zip(*(part.tolist() for part in (base, ages, inverse_volume)), strict=True)
    ]
    if isinstance(hold, Dropped):
        return [worths[0] + sum(base) - sum(worths), *worths[1:]]
    total = sum(worths)
    return [one / total for one in worths] if total else [1.0] + [0.0] * (len(worths) - 1)
