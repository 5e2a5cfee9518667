"""Run one case of time and lives."""

from typing import NamedTuple

from concord.experiments.simulation_testing.broken import Broken
from concord.experiments.simulation_testing.lives.case import LivesCase
from concord.experiments.simulation_testing.lives.network import LivesNetwork
from concord.experiments.simulation_testing.lives.promises import RAISED
from concord.runtime.processes.environment.failures import Deserted


class LivesOutcome(NamedTuple):
    """Outcome of a case: the broken promise, or None, and what was seen; counts of the run."""

    seed: int
    broken: str | None
    seen: str
    estimates: int
    joins: int


def run_lives(case: LivesCase) -> LivesOutcome:
    """Run a case to its end or to the first promise that breaks."""
    network = LivesNetwork(case)
    broken, seen = None, ""
    try:
        network.run()
    except Deserted:
        # All processes are dead: the run has no other end.
        pass
    except Broken as error:
        broken, seen = error.invariant, error.seen
    except Exception as error:  # whatever a machine raises is what is looked for
        broken, seen = RAISED, f"{type(error).__name__}: {error}"
    return LivesOutcome(case.seed, broken, seen, network.watch.estimates, network.watch.joins)
