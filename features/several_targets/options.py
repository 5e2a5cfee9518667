"""Options of several targets: the plant and the rule of shared tracks."""

from typing import Annotated, ClassVar, Literal

from concord.scenarios.types.option import Option
from concord.scenarios.types.plants import PlacedSensors
from concord.scenarios.types.rules import FusionRule

MOST_CLUTTER = 200
FALSE_ALARM = 1e-3
"""Probability of a false alarm in a cell, which joins detection probability and echo."""


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


class TrackIntersection(FusionRule, frozen=True, kw_only=True, tag="track-ci"):
    """Tracks of several targets, fused by covariance intersection (target-swarm)."""

    unavailable: ClassVar[str] = "nodes share tracks of several targets, as target-swarm has them"
    most_tracks: Annotated[
        int,
        Option("Most tracks in a share: those that most probably exist.", at_least=1, at_most=100),
    ] = 12
