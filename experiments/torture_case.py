"""One case of torture: a scenario, what becomes of its network, and faults of single frames."""

from collections.abc import Mapping
from typing import Any

import msgspec

from experiments.torture_frames import read_frame_faults
from scenarios.scenario import Scenario
from scenarios.script import script_of


class Case(msgspec.Struct, frozen=True):
    """Equal cases give equal runs, bit for bit.

    Attributes:
        seed: of the fates of frames and the order of events.
        scenario: what is simulated; its `changes` are faults and their ends.
        frame_faults: kinds and probabilities, "duplicate 0.2" (`torture_frames`).
        calm_step: from this step on nothing is wrong any more.
    """

    seed: int
    scenario: Scenario
    frame_faults: tuple[str, ...]
    calm_step: int


# What an option of the command may say of a case, beside the fields of its scenario.
OWN_FIELDS = ("frame_faults", "calm_step")


def with_fields(case: Case, fields: Mapping[str, Any]) -> Case:
    """The case with these fields of its own or of its scenario."""
    own = {name: value for name, value in fields.items() if name in OWN_FIELDS}
    other = {name: value for name, value in fields.items() if name not in OWN_FIELDS}
    scenario = msgspec.structs.replace(case.scenario, **other)
    return msgspec.structs.replace(case, scenario=scenario, **own)


def check_case(case: Case) -> None:
    """Refuse faults that are none.

    Raises:
        ValueError: naming the option, its value and the rule.
    """
    read_frame_faults(case.frame_faults)
    if not 0 <= case.calm_step <= case.scenario.steps:
        raise ValueError(
            f"--calm-step {case.calm_step}: must be 0 to {case.scenario.steps}, the steps there are"
        )
    late = [step for step, _ in script_of(case.scenario) if step > case.calm_step]
    if late:
        raise ValueError(
            f"--changes at step {late[-1]}: the network is calm from step {case.calm_step} on "
            "(--calm-step)"
        )


def differences(case: Case, drawn: Case) -> dict[str, Any]:
    """The fields in which a case is not the drawn one, by the names of options."""
    one, other = _fields(case), _fields(drawn)
    return {name: value for name, value in one.items() if value != other[name]}


def _fields(case: Case) -> dict[str, Any]:
    scenario = {name: getattr(case.scenario, name) for name in case.scenario.__struct_fields__}
    return {**scenario, **{name: getattr(case, name) for name in OWN_FIELDS}}
