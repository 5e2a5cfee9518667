"""Which networks can use readings that come late."""

from concord.scenarios.scenario import Scenario
from concord.scenarios.types.rules import LEAST_WINDOW_STEPS, MeasurementFlooding


def refuse_late(scenario: Scenario, late_steps: tuple[int, ...], gates: str, named: str) -> None:
    """Refuse late readings that no window can put back.

    Args:
        scenario: that is asked for.
        late_steps: of each node; empty where all readings come at once.
        gates: option or field of the gates of sensors; empty where no late sensor has one.
        named: option or field that makes them late.

    Raises:
        ValueError: naming it and the cure.
    """
    if not late_steps:
        return
    rule = scenario.rule
    if not isinstance(rule, MeasurementFlooding):
        raise ValueError(
            f"{named}: rule {rule.name} has no window that puts late readings back; use --rule "
            "labelled --filter ukf --cluster fitted"
        )
    if gates or rule.gate_probability or rule.withhold_below:
        own = f"{gates}, " * bool(gates)
        raise ValueError(
            f"{named}: a node judges a reading before it comes; leave {own}--gate-probability and "
            "--withhold-below out"
        )
    longest, window = max(late_steps), rule.window_steps or LEAST_WINDOW_STEPS
    if longest >= window:
        raise ValueError(
            f"{named}: readings come up to {longest} steps late, but the window has {window}; use "
            f"--window-steps {longest + LEAST_WINDOW_STEPS}"
        )
