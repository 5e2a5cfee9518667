"""FlexRay as a toolbox: frames, recordings, clusters, exchange files, times and schedules.

    from concord.features.flexray_tools.api import Frame, decode_frame, encode_frame

    data = encode_frame(Frame(frame_id=5, cycle_count=0, payload=b"ab"))

docs/flexray_toolbox.md has a how-to for each task.
"""

from concord.bus.bus import Captured
from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.bus.flexray.cluster_files import (
    cluster_from_toml,
    cluster_to_toml,
    read_cluster_file,
)
from concord.bus.flexray.dynamic_segment import MessageSlot, Request, Walk, walk
from concord.bus.flexray.frame import Frame, FrameError, Inspection
from concord.bus.flexray.frame import decode as decode_frame
from concord.bus.flexray.frame import encode as encode_frame
from concord.bus.flexray.frame import inspect as inspect_frame
from concord.bus.flexray.levels import broken_rules, precision_us
from concord.bus.flexray.presets import preset
from concord.bus.flexray.slot_file import read_slot_file, slots_from_toml, slots_to_toml
from concord.bus.flexray.timing import segments
from concord.bus.pcap import write_pcap
from concord.features.flexray_tools.commands.decoded_signals import read_described_signals
from concord.features.flexray_tools.files.arxml import (
    arxml_with_slots,
    cluster_from_arxml,
    cluster_to_arxml,
    slots_from_arxml,
)
from concord.features.flexray_tools.files.fibex import (
    cluster_from_fibex,
    cluster_to_fibex,
    fibex_with_slots,
    slots_from_fibex,
)
from concord.features.flexray_tools.frame_logs.log_files import FrameLog
from concord.features.flexray_tools.recordings.decoder import (
    DecodedFrame,
    Decoding,
    decode_waveform,
)
from concord.features.flexray_tools.recordings.fit import Fit
from concord.features.flexray_tools.recordings.fit import fit as fit_recording
from concord.features.flexray_tools.recordings.recorded_cluster import (
    RecordedCluster,
    recorded_cluster,
    recorded_slots,
)
from concord.features.flexray_tools.recordings.recording_files import read_recording
from concord.features.flexray_tools.recordings.transmitted import transmitted
from concord.features.flexray_tools.recordings.waveform import (
    RecordedSignals,
    Waveform,
    WaveformError,
)
from concord.features.flexray_tools.response_times import FrameResponse, ResponseTimes
from concord.features.flexray_tools.signals.coding import (
    Coding,
    DescribedSignals,
    FrameSignals,
    PlacedSignal,
)
from concord.features.flexray_tools.signals.signal_log import (
    FrameSeries,
    SignalLog,
    signals_of_log,
    write_signals,
)
from concord.features.flexray_tools.slot_design.demand import (
    Demand,
    FrameDemand,
    ShareDemand,
    read_demand,
)
from concord.features.flexray_tools.slot_design.design import SlotDesign, design_slots
from concord.features.flexray_tools.traffic import worst_responses

__all__ = [
    "Captured",
    "Cluster",
    "ClusterError",
    "Coding",
    "DecodedFrame",
    "Decoding",
    "Demand",
    "DescribedSignals",
    "Fit",
    "Frame",
    "FrameDemand",
    "FrameError",
    "FrameLog",
    "FrameResponse",
    "FrameSeries",
    "FrameSignals",
    "Inspection",
    "MessageSlot",
    "PlacedSignal",
    "RecordedCluster",
    "RecordedSignals",
    "Request",
    "ResponseTimes",
    "ShareDemand",
    "SignalLog",
    "SlotDesign",
    "Walk",
    "Waveform",
    "WaveformError",
    "arxml_with_slots",
    "broken_rules",
    "cluster_from_arxml",
    "cluster_from_fibex",
    "cluster_from_toml",
    "cluster_to_arxml",
    "cluster_to_fibex",
    "cluster_to_toml",
    "decode_frame",
    "decode_waveform",
    "design_slots",
    "encode_frame",
    "fibex_with_slots",
    "fit_recording",
    "inspect_frame",
    "precision_us",
    "preset",
    "read_cluster_file",
    "read_demand",
    "read_described_signals",
    "read_recording",
    "read_slot_file",
    "recorded_cluster",
    "recorded_slots",
    "segments",
    "signals_of_log",
    "slots_from_arxml",
    "slots_from_fibex",
    "slots_from_toml",
    "slots_to_toml",
    "transmitted",
    "walk",
    "worst_responses",
    "write_pcap",
    "write_signals",
]
