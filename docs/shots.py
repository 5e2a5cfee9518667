"""The pictures that `docs/screenshots.py` takes: recorded runs, and networks that run."""

from typing import Any, NamedTuple


class Shot(NamedTuple):
    """One picture: the scenario with its changes, the step, and the selection on the page."""

    scenario: str
    changes: dict[str, Any]
    step: int
    view: dict[str, Any]
    light: bool = False
    size: tuple[int, int] = (1600, 900)
    tab: str | None = None


_HYBRID = {"schedule": "hybrid", "occupancy": 0.5}
_SIZES = ((1920, 1080), (1366, 768), (1280, 800), (800, 600))
_NETWORKS = {
    "8": Shot("target-tracking", {"nodes": 8, "steps": 60}, 50, {}),
    "24": Shot("target-tracking", {"nodes": 24, "steps": 90, **_HYBRID}, 60, {"selected": 5}),
    "100": Shot(
        "target-tracking", {"nodes": 100, "steps": 40, "schedule": "hybrid", "occupancy": 0.1}, 39,
        {"selected": 21},
    ),
    "vehicle": Shot("vehicle-network", {"steps": 700}, 690, {"selected": 1}),
    "mrclam": Shot("mrclam", {"steps": 1500}, 1400, {"selected": 1}),
    "sets": Shot("liu2021-network", {"steps": 60, "rule": "zonotope"}, 40, {"selected": 2}),
}  # fmt: skip
_EIGHT = {"nodes": 8, "steps": 40}
_REPAIRS = {
    "1-set-after-a-kill": Shot(
        "target-tracking",
        {**_EIGHT, "changes": ("10 kill 6", "14 set occupancy=0.5 schedule=hybrid")}, 19, {},
    ),
    "4-before-the-set": Shot(
        "target-tracking",
        {**_EIGHT, "changes": ("10 kill 6", "14 set occupancy=0.5 schedule=hybrid")}, 13, {},
    ),
    "5-charts-at-first": Shot("oscillator", {"nodes": 8, "steps": 80}, 1, {}),
    "6-divergence": Shot("target-tracking", {**_EIGHT, "changes": ("10 lie 3 5 4",)}, 39, {}),
    "8-missed-frames": Shot("target-tracking", {**_EIGHT, "loss": 0.2}, 30, {}, light=True),
}  # fmt: skip
SHOTS = {
    **{
        f"{name}-{size[0]}-{'light' if light else 'dark'}": shot._replace(size=size, light=light)
        for number, (name, shot) in enumerate(_NETWORKS.items())
        for place, size in enumerate(_SIZES)
        for light in [(number + place) % 2 == 1]
    },
    **_REPAIRS,
    "dark": Shot("target-tracking", {"nodes": 16, "steps": 90, **_HYBRID}, 78, {"selected": 7}),
    "light": Shot(
        "target-tracking", {"nodes": 16, "steps": 90, **_HYBRID}, 78, {"selected": 7}, light=True
    ),
    "200-nodes": Shot(
        "target-tracking",
        {"nodes": 200, "steps": 45, "schedule": "hybrid", "occupancy": 0.1},
        44,
        {"selected": 21},
    ),
    "targets": Shot("target-swarm", {"targets": 10}, 70, {"selected": 4}, size=(1366, 768)),
    "phone": Shot("target-tracking", {"nodes": 8, "steps": 60}, 50, {}, size=(390, 844)),
    "replay": Shot(
        "oscillator", {"nodes": 12, "steps": 80, "graph": "small-world"}, 40, {"selected": 4},
        light=True, size=(1280, 720),
    ),
    "400-nodes": Shot(
        "target-tracking",
        {"nodes": 400, "steps": 40, "graph": "4-regular", "schedule": "hybrid", "occupancy": 0.05},
        39,
        {"selected": 21},
        size=(1920, 1080),
    ),
    "sets": Shot(
        "liu2021-network", {"steps": 60, "rule": "zonotope"}, 40, {"selected": 2},
        size=(1920, 1080), tab="Beliefs",
    ),
}  # fmt: skip


class LiveShot(NamedTuple):
    """A picture of eight nodes that run: steps, acts, and what the page says in the end.

    `acts` are commands (docs/control.md); `wait` for some steps, `open` the page, and `end` the
    network.
    """

    steps: int
    acts: tuple[str, ...]
    state: str


LIVE_SHOTS = {
    "2-ended": LiveShot(150, ("speed 10", "open"), "ENDED"),
    "3-silent": LiveShot(9000, ("speed 10", "open", "wait", "pause", "end"), "SILENT"),
    "7-attached-to-a-paused": LiveShot(9000, ("speed 10", "wait", "pause", "open"), "PAUSED"),
    "8-changes-that-wait": LiveShot(
        9000, ("speed 10", "open", "wait", "pause", "kill 2", "cut 0 1", "lie 3 5 4"), "PAUSED"
    ),
}
