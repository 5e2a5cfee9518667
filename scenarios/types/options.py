"""Options of a scenario as keywords, generated from their declarations.

`python -m concord.experiments.options_page` writes this file; change `scenarios/types/` instead.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, TypedDict

import numpy as np

from concord.filters.filter import Filter
from concord.scenarios.types.option import Choice

PLACEMENT = int | str | np.ndarray
FUNCTION = str | Choice | Callable[..., object]
FILTER = str | Choice | Filter
if TYPE_CHECKING:
    import networkx

    GRAPH = str | networkx.Graph | np.ndarray
else:
    GRAPH = object
ASSOCIATION = Literal["jpda", "nearest"]
NOISE = Literal["matched", "paper", "growing", "small", "outliers", "biased"]
ARRIVAL = Literal["stamped", "late"]
NUMBER = Literal["float64", "float32", "float16"]
RECORD_NUMBER = Literal["int12", "int16", "float32", "float64"]
CHANNELS = Literal["all", "A", "B", "split", "mixed"]
IDENTIFIERS = Literal["base", "extended"]
METHOD = Literal["tight", "fast-rate", "fast", "paper"]


class ScenarioOptions(TypedDict, total=False):
    """One value of each option."""

    placement: PLACEMENT
    targets: int
    detection: float
    clutter: float
    merge_m: float
    association: ASSOCIATION
    target: int
    data: str | None
    control: str
    noise: NOISE
    static_slots: int
    car: str
    manoeuvre: str
    arrival: ARRIVAL
    process_noise: float
    sensor_gate: float
    nodes: int
    graph: GRAPH
    weights: str
    links: str
    loss: float
    rule: FUNCTION
    number: NUMBER
    hold: str | Choice
    decay: float
    determinant_weights: bool
    liars: int
    window_steps: int | None
    digest_steps: int | None
    repeat_above: float
    repeat_bytes: int
    payload_bytes: int | None
    relay: bool
    latch_delay_us: float
    gate_probability: float
    withhold_below: float
    record_number: RECORD_NUMBER
    smooth_steps: int
    most_tracks: int
    bid_weights: str
    rounds: int
    bus: FUNCTION
    stretch: float
    schedule: str | Choice
    occupancy: float
    arbiter: str
    urgency_classes: int
    trigger: float
    slots: str
    cluster: str
    channels: CHANNELS
    withdrawal: bool
    opportunity_bits: int
    burst_frames: int
    identifiers: IDENTIFIERS
    nominal_kbit_s: int
    data_kbit_s: int
    retransmissions: int
    filter: FILTER
    iterations: int
    change: float
    turn_rate_std: float
    bandwidth: float
    least_noise: float
    most_noise: float
    forgetting: float
    outlier_limit: float
    innovations: int
    losers: bool
    method: METHOD
    accuracy: float
    generators: int
    constraints: int
    steps: int
    seed: int
    run: int
    changes: Sequence[str]


class SweptOptions(TypedDict, total=False):
    """One value of each option, or several."""

    placement: Sequence[PLACEMENT] | np.ndarray | PLACEMENT
    targets: Sequence[int] | np.ndarray | int
    detection: Sequence[float] | np.ndarray | float
    clutter: Sequence[float] | np.ndarray | float
    merge_m: Sequence[float] | np.ndarray | float
    association: Sequence[ASSOCIATION] | np.ndarray | ASSOCIATION
    target: Sequence[int] | np.ndarray | int
    data: Sequence[str | None] | np.ndarray | str | None
    control: Sequence[str] | np.ndarray | str
    noise: Sequence[NOISE] | np.ndarray | NOISE
    static_slots: Sequence[int] | np.ndarray | int
    car: Sequence[str] | np.ndarray | str
    manoeuvre: Sequence[str] | np.ndarray | str
    arrival: Sequence[ARRIVAL] | np.ndarray | ARRIVAL
    process_noise: Sequence[float] | np.ndarray | float
    sensor_gate: Sequence[float] | np.ndarray | float
    nodes: Sequence[int] | np.ndarray | int
    graph: Sequence[GRAPH] | np.ndarray | GRAPH
    weights: Sequence[str] | np.ndarray | str
    links: Sequence[str] | np.ndarray | str
    loss: Sequence[float] | np.ndarray | float
    rule: Sequence[FUNCTION] | np.ndarray | FUNCTION
    number: Sequence[NUMBER] | np.ndarray | NUMBER
    hold: Sequence[str | Choice] | np.ndarray | str | Choice
    decay: Sequence[float] | np.ndarray | float
    determinant_weights: Sequence[bool] | np.ndarray | bool
    liars: Sequence[int] | np.ndarray | int
    window_steps: Sequence[int | None] | np.ndarray | int | None
    digest_steps: Sequence[int | None] | np.ndarray | int | None
    repeat_above: Sequence[float] | np.ndarray | float
    repeat_bytes: Sequence[int] | np.ndarray | int
    payload_bytes: Sequence[int | None] | np.ndarray | int | None
    relay: Sequence[bool] | np.ndarray | bool
    latch_delay_us: Sequence[float] | np.ndarray | float
    gate_probability: Sequence[float] | np.ndarray | float
    withhold_below: Sequence[float] | np.ndarray | float
    record_number: Sequence[RECORD_NUMBER] | np.ndarray | RECORD_NUMBER
    smooth_steps: Sequence[int] | np.ndarray | int
    most_tracks: Sequence[int] | np.ndarray | int
    bid_weights: Sequence[str] | np.ndarray | str
    rounds: Sequence[int] | np.ndarray | int
    bus: Sequence[FUNCTION] | np.ndarray | FUNCTION
    stretch: Sequence[float] | np.ndarray | float
    schedule: Sequence[str | Choice] | np.ndarray | str | Choice
    occupancy: Sequence[float] | np.ndarray | float
    arbiter: Sequence[str] | np.ndarray | str
    urgency_classes: Sequence[int] | np.ndarray | int
    trigger: Sequence[float] | np.ndarray | float
    slots: Sequence[str] | np.ndarray | str
    cluster: Sequence[str] | np.ndarray | str
    channels: Sequence[CHANNELS] | np.ndarray | CHANNELS
    withdrawal: Sequence[bool] | np.ndarray | bool
    opportunity_bits: Sequence[int] | np.ndarray | int
    burst_frames: Sequence[int] | np.ndarray | int
    identifiers: Sequence[IDENTIFIERS] | np.ndarray | IDENTIFIERS
    nominal_kbit_s: Sequence[int] | np.ndarray | int
    data_kbit_s: Sequence[int] | np.ndarray | int
    retransmissions: Sequence[int] | np.ndarray | int
    filter: Sequence[FILTER] | np.ndarray | FILTER
    iterations: Sequence[int] | np.ndarray | int
    change: Sequence[float] | np.ndarray | float
    turn_rate_std: Sequence[float] | np.ndarray | float
    bandwidth: Sequence[float] | np.ndarray | float
    least_noise: Sequence[float] | np.ndarray | float
    most_noise: Sequence[float] | np.ndarray | float
    forgetting: Sequence[float] | np.ndarray | float
    outlier_limit: Sequence[float] | np.ndarray | float
    innovations: Sequence[int] | np.ndarray | int
    losers: Sequence[bool] | np.ndarray | bool
    method: Sequence[METHOD] | np.ndarray | METHOD
    accuracy: Sequence[float] | np.ndarray | float
    generators: Sequence[int] | np.ndarray | int
    constraints: Sequence[int] | np.ndarray | int
    steps: Sequence[int] | np.ndarray | int
    seed: Sequence[int] | np.ndarray | int
    run: Sequence[int] | np.ndarray | int
    changes: Sequence[Sequence[str]] | np.ndarray | Sequence[str]
