"""The weights that a hold policy promises, worked out number by number."""

from nodes.messages import Array
from scenarios.rules import rule_of
from scenarios.scenario import Scenario


def promised_weights(
    scenario: Scenario, base: Array, ages: Array, sharpness: Array, cycles_in_step: int
) -> list[float]:
    """Weights (J,) of a node's own belief and of those that it holds, of these ages in cycles."""
    hold = scenario.hold if rule_of(scenario).holds else "renormalise"

    def worth(weight: float, age: int, sharp: float) -> float:
        if age < 0:
            return 0.0
        match hold:
            case "decayed":
                return weight * scenario.decay**age * sharp
            case "drop" | "renormalise":
                return weight if age == 0 else 0.0
            case "in-step":
                return weight if age <= cycles_in_step else 0.0
        return weight

    worths = [
        worth(*one)
        for one in zip(*(part.tolist() for part in (base, ages, sharpness)), strict=True)
    ]
    if hold == "drop":
        return [worths[0] + sum(base) - sum(worths), *worths[1:]]
    total = sum(worths)
    return [one / total for one in worths] if total else [1.0] + [0.0] * (len(worths) - 1)
