"""Plants as values: which plant with its sensors and models is simulated, with its own options."""

from typing import Annotated, Literal

from concord.features.several_targets.scanning import FALSE_ALARM, MOST_CLUTTER
from concord.scenarios.types.option import USER, Choice, Option
from concord.scenarios.user.values import FromFile, ValueSource, is_source_name, source_of

DATA = Option("Folder of recorded data.")


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


class TargetSwarm(PlacedSensors, frozen=True, kw_only=True, tag="target-swarm"):
    """Several targets that come and go, seen with misses and clutter; detections have no names."""

    # The ground has one target to each square of 70 m at most.
    targets: Annotated[
        int, Option("Targets that are there at some time.", at_least=1, at_most=200)
    ] = 5
    detection: Annotated[
        float,
        Option("Detection probability at 0.71 of the field of view; nearer targets have more.",
               above=FALSE_ALARM, below=1,
               cure="choose for example 0.9: a sensor that is blind or misses nothing has no echo "
               "that falls with range"),
    ] = 0.9  # fmt: skip
    clutter: Annotated[
        float,
        Option(
            "Expected clutter detections in a scan.",
            at_least=0,
            at_most=MOST_CLUTTER,
            cure="choose for example 5: a record has room for 255 detections",
        ),
    ] = 5.0
    merge_m: Annotated[
        float,
        Option("Detected targets at most so far apart give a single detection; 0 for none.",
               unit="m", at_least=0),
    ] = 0.0  # fmt: skip
    association: Annotated[
        Literal["jpda", "nearest"],
        Option("How trackers assign detections: jpda (by joint probabilities) or nearest (the "
               "best joint hypothesis)."),
    ] = "jpda"  # fmt: skip


class DampedOscillator(SensedPlantChoice, frozen=True, kw_only=True, tag="oscillator"):
    """Lightly damped oscillator; nodes see position, velocity or nothing."""


class RecordedRobots(SensedPlantChoice, frozen=True, kw_only=True, tag="mrclam"):
    """Four real robots track the fifth; needs --data and --target."""

    target: Annotated[int, Option("The robot to be tracked, 1 to 5.")] = 1
    data: Annotated[str | None, DATA] = None


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


class CruiseControl(ControlledPlant, frozen=True, kw_only=True, tag="cruise-control"):
    """Speed of a car under cruise control."""


class Suspension(ControlledPlant, frozen=True, kw_only=True, tag="suspension"):
    """Quarter-bus suspension under integral control."""


class AircraftPitch(ControlledPlant, frozen=True, kw_only=True, tag="aircraft-pitch"):
    """Pitch of an aircraft under linear-quadratic control."""


class MotorSpeed(ControlledPlant, frozen=True, kw_only=True, tag="dc-motor-speed"):
    """Speed of a DC motor under state feedback."""


class MotorPosition(ControlledPlant, frozen=True, kw_only=True, tag="dc-motor-position"):
    """Position of a DC motor under state feedback."""


class UnstableBounded(ControlledPlant, frozen=True, kw_only=True, tag="liu2021-network"):
    """An unstable plant under bounded noise, for sets that hold the truth for certain."""


class StochasticReceiver(SensedPlantChoice, frozen=True, kw_only=True, tag="meng2025"):
    """Six sensors share one slot per step to an estimator (Meng et al. 2025)."""


class StochasticNetwork(SensedPlantChoice, frozen=True, kw_only=True, tag="meng2025-network"):
    """A network of estimators as in meng2025, each behind a measurement bus of its own."""

    static_slots: Annotated[
        int, Option("Sensors of a measurement bus that own a slot each.", at_least=0)
    ] = 4


class BoundedReceiver(SensedPlantChoice, frozen=True, kw_only=True, tag="liu2021"):
    """Four sensors of an unstable plant under bounded noise share a slot (Liu et al. 2021)."""

    noise: Annotated[
        Literal["matched", "paper"],
        Option("Noise of the plant: matched (on its bound, as sets must expect) or paper (as "
               "printed)."),
    ] = "matched"  # fmt: skip


class VehicleNetwork(SensedPlantChoice, frozen=True, kw_only=True, tag="vehicle-network"):
    """A car's sensors on its FlexRay bus estimate its motion; `aukf` learns their noise."""

    car: Annotated[
        str, Option("Which car is simulated: bmw-320i, bmw-320i-soft, ford-escort or vw-vanagon.")
    ] = "bmw-320i"
    manoeuvre: Annotated[
        str, Option("Manoeuvre of the driver: double-lane-change, serpentine, ramp-steer, ...")
    ] = "serpentine"
    noise: Annotated[
        Literal["matched", "growing", "small", "outliers", "biased"],
        Option("Noise of the sensors of the car."),
    ] = "growing"
    data: Annotated[str | None, DATA] = None
    arrival: Annotated[
        Literal["stamped", "late"],
        Option("When nodes have the readings of a log: at their stamps less the delays, or as much "
               "later as the delays say (rule labelled puts them back)."),
    ] = "stamped"  # fmt: skip
    process_noise: Annotated[
        float,
        Option(
            "Standard deviations of the filters' process noise over those of the car file.",
            above=0,
        ),
    ] = 1.0
    sensor_gate: Annotated[
        float,
        Option("Do not use readings of the car's sensors that are less likely than this; 0 uses "
               "all.", at_least=0, below=1),
    ] = 0.0  # fmt: skip


class UserPlant(FromFile, SensedPlantChoice, frozen=True, kw_only=True, tag=USER):
    """A plant and sensors of your own, from a Python file."""

    source: str = ""
    digest: str = ""

    @classmethod
    def of(cls, source: ValueSource) -> "UserPlant":
        """The choice of a scenario by its source."""
        return cls(source=source.name, digest=source.digest)

    @classmethod
    def made_of(cls, asked: object) -> "UserPlant | None":
        """A scenario by the name of its file."""
        return cls.of(source_of(str(asked))) if is_source_name(asked) else None


PlantChoice = (
    TargetTracking
    | TargetCrossing
    | TargetSwarm
    | DampedOscillator
    | RecordedRobots
    | CruiseControl
    | Suspension
    | AircraftPitch
    | MotorSpeed
    | MotorPosition
    | StochasticReceiver
    | StochasticNetwork
    | BoundedReceiver
    | UnstableBounded
    | VehicleNetwork
    | UserPlant
)


def noise_of(plant: SensedPlantChoice) -> str:
    """Return the true noise of a plant's sensors; "matched" where the plant has no choice."""
    return plant.noise if isinstance(plant, ControlledPlant | VehicleNetwork) else "matched"
