"""Options of 10BASE-T1S with PLCA and of CAN FD."""

from typing import Annotated, ClassVar, Literal

from concord.scenarios.types.buses import SCHEDULE, ScheduleChoice, TimedBus
from concord.scenarios.types.option import Option
from concord.scenarios.types.schedules import FullSchedule


class Plca(TimedBus, frozen=True, kw_only=True, tag="plca"):
    """10BASE-T1S with PLCA: Ethernet at 10 Mbit/s on one pair, transmit opportunities in order."""

    partial_schedule: ClassVar[str] = "round-robin"
    schedule: Annotated[ScheduleChoice, SCHEDULE] = FullSchedule()
    opportunity_bits: Annotated[
        int,
        Option("Transmit opportunity that a node leaves unused, in bit times.", at_least=1,
               at_most=255),
    ] = 32  # fmt: skip
    burst_frames: Annotated[
        int,
        Option("Frames that a node may send after the first in one transmit opportunity.",
               at_least=0, at_most=255),
    ] = 0  # fmt: skip
    burst_timer_bits: Annotated[
        int, Option("Wait in a burst that is not full, in bit times.", at_least=0, at_most=255)
    ] = 128
    without_beacons: Annotated[
        Literal["csma-cd", "silence"],
        Option("Behaviour of nodes while node 0, which beacons, is out."),
    ] = "csma-cd"


class CanFd(TimedBus, frozen=True, kw_only=True, tag="can-fd"):
    """CAN FD: frames arbitrate by identifiers, which bids choose; the lowest identifier wins."""

    serves_urgency: ClassVar[bool] = True
    schedule: Annotated[ScheduleChoice, SCHEDULE] = FullSchedule()
    identifiers: Annotated[
        Literal["base", "extended"], Option("Identifiers of 11 bits (base) or of 29 (extended).")
    ] = "extended"
    nominal_kbit_s: Annotated[
        int, Option("Bit rate of the arbitration.", unit="kbit/s", at_least=10, at_most=1000)
    ] = 500
    data_kbit_s: Annotated[
        int, Option("Bit rate of the data.", unit="kbit/s", at_least=10, at_most=8000)
    ] = 2000
    retransmissions: Annotated[
        int,
        Option(
            "How often a frame is sent again after an error; a cycle has time for it.",
            at_least=0,
            at_most=16,
        ),
    ] = 0
