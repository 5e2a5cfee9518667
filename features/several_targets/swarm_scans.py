"""The rule `labelled` of `target-swarm`: nodes flood their scans, and track by all of them."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from concord.bus.bus import Bus
from concord.features.several_targets.batched_scans import BatchedScanFlooding
from concord.features.several_targets.scan_codec import ScanCodec, scan_codec
from concord.features.several_targets.scan_flooding import (
    KeptTracks,
    RecordsAlone,
    ScanFlooding,
    StepRecords,
    TrackStep,
)
from concord.features.several_targets.swarm_tracking import (
    STATES,
    UNDETECTED,
    model_of,
    plant_of,
    scans_of,
    settings_of,
)
from concord.features.several_targets.tracking.tracker import Tracked, track
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.labelled import BatchedFlooding
from concord.nodes.lanes.links import Links
from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.labelled.flooding import LabelledFlooding
from concord.nodes.rules.labelled.frame import LabelledFrameCodec, labelled_bytes, least_limit
from concord.nodes.vector_codec import BeliefCodec
from concord.scenarios.filter_table.filters import build_filter
from concord.scenarios.node_context import Beginning
from concord.scenarios.rule_table.labelled import (
    check_labelled,
    choice_of,
    digest_of,
    flooding_of,
    largest_share,
    window_of,
    without_arrays,
)
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.scenario_definition import NetworkWiring
from concord.scenarios.setup import Setup
from concord.scenarios.types.filters import UnscentedFilter

Moments = Callable[[Gaussian], Gaussian]
# Nodes of one process are at most so many steps apart.
_LEAD_STEPS = 4


def _check(setup: Setup) -> None:
    rule = flooding_of(setup.scenario)
    why = "a record is a scan, and its tracker judges the detections"
    require(rule.record_number == "int16", "record-number", rule.record_number, f"int16: {why}")
    for option in ("gate_probability", "withhold_below", "smooth_steps"):
        value = getattr(rule, option)
        require(value == 0, option, value, f"0: {why}")
    # Finding room for a detection is what else can fail, and says why.
    _scan_codec(setup.scenario)
    check_labelled(setup.scenario, setup.neighbours, None)


def _share_bytes(scenario: Scenario) -> int:
    return largest_share(scenario, STATES)


def _scan_codec(scenario: Scenario) -> ScanCodec:
    """How scans are written.

    Raises:
        ValueError: a share has no room for a detection.
    """
    sensor = plant_of(scenario).sensors[0]
    head = least_limit(scenario.nodes, digest_of(scenario), labelled_bytes(0))
    least, most = sensor.span()
    return scan_codec(least, most, sensor.sensor.noise_std, _share_bytes(scenario) - head)


@lru_cache(maxsize=2)
def _tracker(scenario: Scenario, window_steps: int) -> KeptTracks:
    """Return the tracker of nodes; those of one process share it."""
    return new_tracker(scenario, window_steps)


def new_tracker(
    scenario: Scenario, window_steps: int, arrival: np.random.Generator | None = None
) -> KeptTracks:
    """Return a tracker of nodes that no other node shares.

    `arrival` draws an order of scans and detections, on which nothing may depend.
    """
    settings = settings_of(scenario)
    scan = scans_of(scenario, _scan_codec(scenario))

    def after(before: Tracked, step: int, records: StepRecords) -> Tracked:
        scans = [scan(source, record) for source, record in records]
        if arrival is not None:
            arrival.shuffle(scans)
            scans = [one._replace(detections=arrival.permutation(one.detections)) for one in scans]
        return track(before.tracks, scans, settings, step)

    return KeptTracks(after, window_steps + _LEAD_STEPS)


def _flooding_parts(setup: Setup, bus: Bus) -> dict[str, Any]:
    """Return the fields that flooding has at a node and at all nodes of many runs."""
    scenario = setup.scenario
    codec, window_steps = _scan_codec(scenario), window_of(scenario, setup.neighbours)
    codecs = [codec] * scenario.nodes
    frames = LabelledFrameCodec(
        codecs,
        BeliefCodec(STATES, "<f4"),
        window_steps,
        digest_of(scenario),
        _share_bytes(scenario),
    )
    sensors = AllSensors((), scenario.nodes, (1 + codec.readings, codec.channels))
    window = RecordsAlone(
        model_of(scenario), build_filter(UnscentedFilter(), STATES), sensors, codecs
    )
    return {
        "own": (),
        "filter": window,
        "frames": frames,
        "choice": choice_of(scenario, frames),
        "schedule": bus.schedule,
        "rounds": scenario.rounds,
    }


def _tracking_parts(setup: Setup) -> tuple[TrackStep, Tracked, float, Moments]:
    """Return the last fields of `ScanFlooding` and of `BatchedScanFlooding`."""
    settings = settings_of(setup.scenario)
    track = _tracker(setup.scenario, window_of(setup.scenario, setup.neighbours))
    return track, settings.start, UNDETECTED, settings.models.moments


def _estimator(setup: Setup, node: int, bus: Bus, beginning: Beginning) -> ScanFlooding:
    flooding = LabelledFlooding(
        node=node,
        neighbours=setup.neighbours,
        prior=Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov)),
        first_step=beginning.step,
        first_cycle=beginning.cycle,
        **_flooding_parts(setup, bus),
    )
    return ScanFlooding(flooding, *_tracking_parts(setup))


def _batched(setup: Setup, bus: Bus, links: Links) -> BatchedScanFlooding:
    flooding = BatchedFlooding(links=links, **_flooding_parts(setup, bus))
    return BatchedScanFlooding(flooding, *_tracking_parts(setup))


FLOODED_SCANS = NetworkWiring(
    share_bytes=_share_bytes,
    estimator=_estimator,
    batched=_batched,
    check=_check,
    lacking=without_arrays,
)
