"""How the frames of each kind of bus carry shares."""

from collections.abc import Callable
from typing import Any

from concord.bus.bus import FrameFormat
from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.features.other_buses.can_fd.bits import IDENTIFIER_BITS
from concord.features.other_buses.can_fd.frame import FRAMINGS as CAN_FRAMINGS
from concord.features.other_buses.plca.ethernet import FRAMING as ETHERNET
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.buses import CanFd, FlexRay, Ideal, Plca, SharedBus, UserBus
from concord.scenarios.user.bus import user_frame_format

_FORMATS: dict[type[SharedBus], Callable[[Any], FrameFormat]] = {
    FlexRay: lambda _: SHARE_FRAMES,
    Plca: lambda _: ETHERNET.frame_format(),
    CanFd: lambda chosen: CAN_FRAMINGS[IDENTIFIER_BITS[chosen.identifiers]].frame_format(),
    Ideal: lambda _: SHARE_FRAMES,
    UserBus: user_frame_format,
}


def frame_format(scenario: Scenario) -> FrameFormat:
    """Return how the frames of a scenario's bus carry shares."""
    return _FORMATS[type(scenario.bus)](scenario.bus)
