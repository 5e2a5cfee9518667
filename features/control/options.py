"""Options of plants with a controller."""

from concord.scenarios.types.plants import ControlledPlant


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
