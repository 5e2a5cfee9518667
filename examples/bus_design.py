"""How much of the bus does a network need for twice the error of the best filter?"""

import concord as cc

scenario = cc.scenario("oscillator", nodes=5, graph="ring", steps=40)
found = cc.design("2x-centralised", scenario, runs=10, rule="ci", weights="metropolis", rounds=[1])
print("tried", len(found.tried), "networks")
print("recommended:", None if found.recommended is None else found.recommended.command)
