"""Bugs of time and lives, planted in the real functions: `python -m tests.experiments.lives_bugs`.

The script prints the first seed that finds each.
"""

from concord.experiments.simulation_testing.lives.case import draw_lives
from concord.experiments.simulation_testing.lives.case_run import LivesOutcome, run_lives
from tests.experiments.planted_bugs import Bug, print_found

MOST_SEEDS = 200
LIVES_BUGS = (
    Bug(
        "a node that joins takes an old belief for that of now",
        "concord.nodes.environment_changes", "_joined",
        (("newest.step == state.released - 1", "True"),),
    ),
    Bug(
        "a scripted restart that dies while booting is waited for",
        "concord.runtime.processes.environment.decisions", "EnvironmentDecisions._hear_of_end",
        (("self.done(self.controller.not_started(node))", "[]"),),
    ),
    Bug(
        "a node that is too slow works off every reading",
        "concord.runtime.processes.node.timetable", "NodeTimetable.is_lost",
        (("self.late_s(now_s, step) > self.tempo.oldest_s", "False"),),
    ),
    Bug(
        "an environment that stood still ends the run at once",
        "concord.runtime.processes.environment.decisions", "EnvironmentDecisions._give_up",
        (("AwaitReturn(_RETURN_S)", "AwaitReturn(0.0)"),),
    ),
    Bug(
        "a node that joins hears of no change after its welcome",
        "concord.nodes.changes", "since_return",
        (("changes[returns[-1] + 1 :]", "()"),),
    ),
    Bug(
        "a forged end of a node is believed for ever",
        "concord.nodes.run_controller", "RunController.take",
        (("isinstance(event, Estimate) and event.absent", "False"),),
    ),
)  # fmt: skip


def run_seed(seed: int) -> LivesOutcome:
    """Run the case of a seed."""
    return run_lives(draw_lives(seed))


if __name__ == "__main__":
    print_found(LIVES_BUGS, range(1, MOST_SEEDS + 1), run_seed)
