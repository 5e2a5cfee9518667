"""Run a network of processes, and read what it left: arrays with names and units."""

import concord as cc

if __name__ == "__main__":
    scenario = cc.scenario("oscillator", nodes=4, steps=40, occupancy=0.5)
    run = cc.launch(scenario).isel(run=0)
    print(run["ages"].mean("link").values.round(2), run["ages"].attrs["units"])
    print("load of the bus", float(run["bus_load"].mean()))
