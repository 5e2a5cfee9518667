"""A first network: how good is it beside one filter that hears every sensor, and beside none?"""

import concord as cc

scenario = cc.scenario("target-tracking", nodes=8, graph="ring", steps=60)
for rule in ("local", "ci", "hcmci"):
    runs = cc.simulate(scenario.with_(rule=rule), runs=10)
    errors = (runs["mean"] - runs["truth"]).sel(state=["x", "y"])
    rmse_m = float((errors**2).sum("state").isel(step=slice(20, None)).mean() ** 0.5)
    print(f"{rule:6} {rmse_m:8.2f} m")
