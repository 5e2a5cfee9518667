"""The waveform of frames on a cluster, as an ideal bus carries them."""

from collections.abc import Iterable

import numpy as np

from concord.bus.bus import Captured
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_parameters import CHANNEL_IDLE_BITS, TRAILING_BITS
from concord.bus.flexray.share_frames import frame_id_of
from concord.features.flexray_tools.recordings.bitstream import byte_bits
from concord.features.flexray_tools.recordings.waveform import Waveform, WaveformError, from_samples


def transmitted(sent: Iterable[Captured], cluster: Cluster) -> Waveform:
    """Return the signal of frames on one channel; `sent` has their bytes and first bits.

    A dynamic frame has a trailing sequence up to the next action point of a minislot.

    Raises:
        WaveformError: two frames overlap, or no frame is sent.
    """
    bit_ns = 1e3 * cluster.bit_us
    start = np.zeros(cluster.transmission_start_bits, dtype=np.uint8)
    times: list[float] = []
    levels: list[int] = []
    free_us = -np.inf
    for one in sorted(sent, key=lambda captured: captured.time_us):
        if one.time_us < free_us:
            raise WaveformError(
                f"frame {frame_id_of(one.data)} begins at {one.time_us:g} us, but the frame before "
                f"it and {CHANNEL_IDLE_BITS} idle bits last until {free_us:g} us; send it later"
            )
        bits = np.concatenate((start, byte_bits(one.data)))
        begin_ns = one.time_us * 1e3
        if not times:
            times, levels = [begin_ns - CHANNEL_IDLE_BITS * bit_ns], [1]
        times += (begin_ns + bit_ns * np.arange(len(bits))).tolist()
        levels += bits.tolist()
        end_us = one.time_us + len(bits) * cluster.bit_us
        if frame_id_of(one.data) >= cluster.first_dynamic_id:
            least_us = (len(bits) + TRAILING_BITS) * cluster.bit_us
            minislots = np.ceil(least_us / cluster.minislot_us - 1e-9)
            times.append(end_us * 1e3)
            levels.append(0)
            end_us = one.time_us + float(minislots) * cluster.minislot_us
        times.append(end_us * 1e3)
        levels.append(1)
        free_us = end_us + CHANNEL_IDLE_BITS * cluster.bit_us
    if not times:
        raise WaveformError("no frame is sent; a waveform has one at least")
    # The recording ends after an idle bus.
    times.append(free_us * 1e3)
    levels.append(1)
    return from_samples([round(time) for time in times], levels)
