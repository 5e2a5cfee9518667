"""The rule `track-ci` of `target-swarm`: nodes track by the scans of their neighbourhood, and
share their tracks."""

from concord.bus.bus import Bus
from concord.features.several_targets.options import TrackIntersection
from concord.features.several_targets.scan_codec import scan_codec
from concord.features.several_targets.scanned_swarm import TARGET_STATES
from concord.features.several_targets.swarm_tracking import (
    UNDETECTED,
    plant_of,
    scans_of,
    settings_of,
)
from concord.features.several_targets.track_codec import TrackCodec
from concord.features.several_targets.track_exchange import TrackExchange
from concord.scenarios.node_context import Beginning
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.scenario_definition import NetworkWiring
from concord.scenarios.setup import Setup
from concord.scenarios.types.filters import UnscentedFilter

_SCAN_BYTES = 40
"""Room for a scan in a share: 19 detections. A full FlexRay cycle holds 20 nodes with it."""


def _codec(scenario: Scenario) -> TrackCodec:
    assert isinstance(scenario.rule, TrackIntersection), "the table of rules chose it"
    sensor = plant_of(scenario).sensors[0]
    scans = scan_codec(*sensor.span(), sensor.sensor.noise_std, _SCAN_BYTES)
    return TrackCodec(TARGET_STATES, scenario.rule.most_tracks, scans)


def _estimator(setup: Setup, node: int, bus: Bus, beginning: Beginning) -> TrackExchange:
    codec = _codec(setup.scenario)
    return TrackExchange(
        node,
        tuple(setup.neighbours[node]),
        scans_of(setup.scenario, codec.scans),
        settings_of(setup.scenario),
        codec,
        UNDETECTED,
        setup.scenario.rounds,
        beginning.step,
    )


def _check(setup: Setup) -> None:
    chosen = setup.scenario.filter
    require(
        isinstance(chosen, UnscentedFilter),
        "filter",
        chosen.name,
        "ukf: a share carries one belief a track; or use --rule labelled, whose shares are scans",
    )


SHARED_TRACKS = NetworkWiring(
    share_bytes=lambda scenario: _codec(scenario).size,
    estimator=_estimator,
    check=_check,
    lacking=lambda _: "rule track-ci",
)
