"""A topology from networkx: does it matter where two rings are joined?"""

import networkx

import concord as cc

scenario = cc.scenario("oscillator", steps=60)
for joints in ([(0, 6)], [(0, 6), (3, 9)]):
    graph = networkx.disjoint_union(networkx.cycle_graph(6), networkx.cycle_graph(6))
    graph.add_edges_from(joints)
    runs = cc.simulate(scenario.with_(graph=graph), runs=10)
    print(len(joints), "joints: trace of the covariances", float(runs["cov_trace"].mean()))
