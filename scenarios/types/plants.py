"""Plants as values: which plant with its sensors and models is simulated, with its own options."""

from typing import Annotated, Literal

import msgspec

from concord.scenarios.types.option import USER, Choice, Option
from concord.scenarios.user.values import FromFile, ValueSource, is_source_name, source_of

DATA = Option("Folder or file of recorded data.")


class SensedPlantChoice(Choice, frozen=True, kw_only=True):
    """A plant, what its sensors measure and what its filters believe."""


class PlacedSensors(SensedPlantChoice, frozen=True, kw_only=True):
    """A plant that is seen by sensors at sites of their own."""

    placement: Annotated[
        int | str,
        Option("Where the sensors stand: number of a random drawing (0, 1, 2, ...), or file:PATH "
               "with a line x, y in m for each node.", is_setting=True),
    ] = 0  # fmt: skip


class TargetTracking(PlacedSensors, frozen=True, kw_only=True, tag="target-tracking"):
    """A turning target seen by range-bearing sensors with a limited field of view."""


class TargetCrossing(PlacedSensors, frozen=True, kw_only=True, tag="target-crossing"):
    """A target on a straight course seen by the same sensors."""


class DampedOscillator(SensedPlantChoice, frozen=True, kw_only=True, tag="oscillator"):
    """Lightly damped oscillator; nodes see position, velocity or nothing."""


class ControlledPlant(SensedPlantChoice, frozen=True, kw_only=True):
    """A plant under a controller."""

    control: Annotated[
        str,
        Option("Source of the estimate that closes the loop: a node's number, truth, or open."),
    ] = "0"
    noise: Annotated[
        Literal["matched", "paper"],
        Option("Noise of the sensors: matched (as the filters believe) or paper (as "
               "printed)."),
    ] = "matched"  # fmt: skip


class UserPlant(FromFile, SensedPlantChoice, frozen=True, kw_only=True, tag=USER):
    """A plant and sensors of your own, from a Python file."""

    source: str = ""
    digest: str = ""
    data: Annotated[str | None, DATA] = None

    @classmethod
    def of(cls, source: ValueSource) -> "UserPlant":
        """The choice of a scenario by its source."""
        return cls(source=source.name, digest=source.digest)

    @classmethod
    def made_of(cls, asked: object) -> "UserPlant | None":
        """A scenario by the name of its file."""
        return cls.of(source_of(str(asked))) if is_source_name(asked) else None


def noise_of(plant: SensedPlantChoice) -> str:
    """Return the true noise of a plant's sensors; "matched" where the plant has no choice."""
    return str(getattr(plant, "noise", "matched"))


class SensorNetwork(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Nodes, the graph of who hears whom, consensus weights, and what links do to frames."""

    nodes: Annotated[int, Option("Number of sensor nodes.", at_least=1, first=True)]
    graph: Annotated[
        str,
        Option("Graph of the network: ring, path, star, grid, complete, 4-regular, geometric, "
               "file:PATH, FILE.py:NAME, ...", is_setting=True, first=True),
    ]  # fmt: skip
    weights: Annotated[
        str,
        Option("Consensus weights: metropolis, maximum-degree, best-constant, fastest-mixing; "
               "equal-neighbour for links that go one way."),
    ] = "metropolis"  # fmt: skip
    links: Annotated[
        str,
        Option("Behaviour of links over time: static, measured (by the graph's own chances), "
               "bernoulli:0.1, markov:0.05,0.3, switching:ring,star:10, moving:300.",
               group="faults"),
    ] = "static"  # fmt: skip
    loss: Annotated[
        float,
        Option("Probability that a link loses a frame on its way to one receiver.",
               group="faults", at_least=0, below=1, first=True),
    ] = 0.0  # fmt: skip
