"""A plant of your own: a pendulum, seen by an encoder at every other node.

`concord run --scenario examples/own_plant.py:PENDULUM` runs it too.
"""

import numpy as np

import concord as cc

STEP_S = 0.05


def move(x: np.ndarray) -> np.ndarray:
    """States (..., 2), angle and rate, one step later."""
    angle, rate = x[..., 0], x[..., 1]
    return np.stack((angle + STEP_S * rate, rate - STEP_S * 9.81 * np.sin(angle)), axis=-1)


PLANT = cc.OwnPlant(f=move, Q=[1e-6, 1e-4], mean=[0.5, 0], cov=[0.1, 0.1], time_step_s=STEP_S)
ENCODER = cc.OwnSensor(h=lambda x: x[..., :1], R=0.01, angles=(0,))
PENDULUM = cc.own_scenario(PLANT, [ENCODER, None], nodes=6)

if __name__ == "__main__":
    runs = cc.simulate(PENDULUM, runs=20)
    anees = runs["nees"].mean(("run", "step")) / PLANT.states
    print("ANEES of each node", anees.values.round(2))
