"""Parameters of start-up and clock synchronisation, each of which a cluster may leave open."""

import msgspec


class ClockParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The parameters by which the nodes of a cluster start up and keep their clocks together.

    None, or no slots: the source does not state the parameter, and no rule looks at it.
    `sync_slots` are the key slots of the sync nodes; nodes with a slot in `startup_slots` may also
    start the cluster. The other values are those of the cluster, or the widest of any node.
    """

    sync_slots: tuple[int, ...] = ()
    startup_slots: tuple[int, ...] = ()
    sync_nodes_most: int | None = None
    cold_start_attempts: int | None = None
    listen_noise: int | None = None
    passive_after_cycle_pairs: int | None = None
    halt_after_cycle_pairs: int | None = None
    drift_damping_microticks: int | None = None
    precision_us: float | None = None
    propagation_delay_us: float | None = None
    offset_correction_us: float | None = None
    offset_correction_start_macroticks: int | None = None
    offset_correction_microticks: int | None = None
    rate_correction_microticks: int | None = None
    drift_microticks: int | None = None
    listen_timeout_microticks: int | None = None
    startup_range_microticks: int | None = None
