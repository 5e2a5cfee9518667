"""Entries of buses other than FlexRay (`concord.entries`)."""

_HERE = "concord.features.other_buses"

BUSES = {
    "plca": (
        f"{_HERE}.plca.plca_bus:DEFINITION",
        "10BASE-T1S with PLCA: Ethernet at 10 Mbit/s on one pair, transmit opportunities in order.",
        f"{_HERE}.options:Plca",
    ),
    "can-fd": (
        f"{_HERE}.can_fd.can_fd_bus:DEFINITION",
        "CAN FD: frames arbitrate by identifiers, which bids choose; the lowest identifier wins.",
        f"{_HERE}.options:CanFd",
    ),
}
