"""A run that is paused goes on by the steps that are asked for, and no further."""

from concord.nodes import environment
from concord.nodes.commands import Pause, Resume, Step
from concord.nodes.messages import Estimate
from concord.nodes.run_controller import ProcessStarter, RunController
from concord.scenarios.build import build_environment
from tests.experiments.support import small

SETUP = small(steps=40, nodes=3, graph="complete")


def controller() -> RunController:
    starter = ProcessStarter(lambda node: None, lambda node: True, lambda before, asked: before)
    found = RunController(build_environment(SETUP), (), starter)
    found.begin()
    return found


def estimate_all(run: RunController) -> int:
    """Let all nodes estimate each step that begins; return the number of steps that began."""
    step = run.state.completed
    while step < run.state.released and not run.finished:
        for node in environment.members(run.config, run.state):
            run.take(Estimate(node, step, [0.0] * 2, [1.0, 0.0, 1.0], [], {}))
        step += 1
    return run.state.released


def test_a_paused_run_begins_the_steps_that_are_asked_for():
    run = controller()
    run.command(Pause())
    still = estimate_all(run)
    assert run.paused and still < SETUP.scenario.steps
    run.command(Step(3))
    assert estimate_all(run) == still + 3
    run.command(Step(1))
    assert estimate_all(run) == still + 4
    run.command(Resume())
    assert estimate_all(run) == SETUP.scenario.steps
