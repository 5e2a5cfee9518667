"""Entries of plants with a controller (`concord.entries`)."""

_HERE = "concord.features.control"

SCENARIOS = {
    "cruise-control": (
        f"{_HERE}.scenario:CRUISE_CONTROL",
        "Speed of a car under cruise control.",
        f"{_HERE}.options:CruiseControl",
    ),
    "suspension": (
        f"{_HERE}.scenario:SUSPENSION",
        "Quarter-bus suspension under integral control.",
        f"{_HERE}.options:Suspension",
    ),
    "aircraft-pitch": (
        f"{_HERE}.scenario:AIRCRAFT_PITCH",
        "Pitch of an aircraft under linear-quadratic control.",
        f"{_HERE}.options:AircraftPitch",
    ),
    "dc-motor-speed": (
        f"{_HERE}.scenario:DC_MOTOR_SPEED",
        "Speed of a DC motor under state feedback.",
        f"{_HERE}.options:MotorSpeed",
    ),
    "dc-motor-position": (
        f"{_HERE}.scenario:DC_MOTOR_POSITION",
        "Position of a DC motor under state feedback.",
        f"{_HERE}.options:MotorPosition",
    ),
}
CASES = {
    "blind": (
        "scenario=dc-motor-position control=open steps=200 seed=1 runs=60",
        "the position of a DC motor without a controller: a plant that drifts, and blind nodes",
    ),
}
