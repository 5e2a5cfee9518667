"""Recorded robots: four of the UTIAS MRCLAM data set track the fifth.

Usage: python examples/recorded_data.py FOLDER, with the folder of one of its sets.
"""

import sys

import concord as cc

if len(sys.argv) != 2:
    sys.exit("name the folder of a MRCLAM set: python examples/recorded_data.py FOLDER")
scenario = cc.scenario("mrclam", data=sys.argv[1], target=4, steps=600)
runs = cc.simulate(scenario)
errors = (runs["mean"] - runs["truth"]).isel(state=[0, 1])
print("error of each robot in m", ((errors**2).sum("state").mean("step") ** 0.5).values.round(2))
