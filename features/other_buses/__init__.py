"""Buses other than FlexRay: 10BASE-T1S with PLCA, and CAN FD."""
