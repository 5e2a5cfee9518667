"""Error against the part of the bus, as in the study of consensus: runs/paper_figure.png."""

from pathlib import Path

import concord as cc

scenario = cc.scenario("target-tracking", nodes=12, steps=60)
swept = cc.sweep(scenario, rule=["ci", "wac"], occupancy=[1, 0.5, 0.25], runs=10)
Path("runs").mkdir(exist_ok=True)
cc.plots(swept)["error-against"].savefig("runs/paper_figure.png", dpi=150)
print("runs/paper_figure.png")
