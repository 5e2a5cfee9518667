"""Promises on time and lives, checked while a case runs."""

from collections.abc import Sequence

from concord.nodes.changes import Welcome
from concord.nodes.messages import Estimate
from concord.nodes.run_controller import RunController
from concord.runtime.processes.environment.decisions import Deserted, EnvironmentDecisions
from tests.laboratory.broken import Broken
from tests.laboratory.lives.case import LivesCase
from tests.laboratory.lives.processes import NodeProcess

_TINY_S = 1e-9
PROMISES = (
    "estimates tell their age, which has a limit",
    "a node that joins is told the step of its belief",
    "no run ends while a node can return",
    "the run ends in time",
    "at the end living nodes with a neighbour are members",
    "all members agree who is out",
    "nothing is raised",
)
_AGE, _BELIEF, _RETURN, _END, _MEMBERS, _AGREE, RAISED = PROMISES


class Watch:
    """Looks at messages and at the end of a run."""

    def __init__(self, case: LivesCase, controller: RunController, start_s: float) -> None:
        self._case, self._controller, self._start_s = case, controller, start_s
        # Steps of all estimates that were sent, by their numbers.
        self._steps: dict[tuple[tuple[float | None, ...], tuple[float | None, ...]], set[int]] = {}
        self.estimates, self.joins = 0, 0

    def hear_estimate(self, estimate: Estimate, now_s: float) -> None:
        """An estimate is sent now.

        Raises:
            Broken: it is older than the timetable allows, or than it says.
        """
        self.estimates += 1
        numbers = tuple(estimate.mean), tuple(estimate.cov)
        self._steps.setdefault(numbers, set()).add(estimate.step)
        tempo = self._case.tempo
        if tempo is None:
            return
        age_s = now_s - self._start_s - estimate.step * tempo.step_s
        if age_s > tempo.oldest_s + _TINY_S:
            seen = f"node {estimate.node}, step {estimate.step}: {age_s:.2f} s"
            raise Broken(_AGE, f"{seen}, limit {tempo.oldest_s:.2f} s")
        if estimate.age_s is None or abs(estimate.age_s - age_s) > _TINY_S:
            raise Broken(_AGE, f"node {estimate.node} says {estimate.age_s}, it is {age_s:.2f} s")

    def hear_welcome(self, welcome: Welcome) -> None:
        """A node is let in.

        Raises:
            Broken: its belief is an estimate of another step than it is told.
        """
        self.joins += 1
        joined = welcome.joined
        if joined.mean is None or joined.cov is None:
            return
        told = welcome.step - 1 if joined.step is None else joined.step
        steps = self._steps.get((tuple(joined.mean), tuple(joined.cov)), set())
        if told not in steps:
            seen = (
                f"node {joined.node} joins in step {welcome.step} with a belief of {sorted(steps)}"
            )
            raise Broken(_BELIEF, f"{seen}, and is told step {told}")

    def check_deserted(
        self, newest: Sequence[NodeProcess], missing: Sequence[int], decisions: EnvironmentDecisions
    ) -> None:
        """Let the environment process end the run if it has to.

        Raises:
            Broken: it ends the run although a process is there that comes back.
            Deserted: it ends the run, and all are dead.
        """
        try:
            decisions.end_if_deserted(missing)
        except Deserted:
            alive = [process.node for process in newest if not process.is_dead]
            if alive:
                raise Broken(_RETURN, f"nodes {alive} are alive") from None
            raise

    def check_end(self, newest: Sequence[NodeProcess]) -> None:
        """Check the network after its run.

        Raises:
            Broken: it has not ended, or its members do not agree.
        """
        state = self._controller.state
        alive = [process for process in newest if not process.is_dead and process.is_ready]
        if not self._controller.finished:
            if not any(not process.is_dead for process in newest):
                return
            raise Broken(_END, f"step {state.completed} of {self._controller.config.steps}")
        absent = set(state.standing.absent)
        # A node whose neighbours are all out has no belief to begin with.
        neighbours = self._controller.config.neighbours
        out = [
            process.node
            for process in alive
            if process.node in absent and set(neighbours[process.node]) - absent
        ]
        if out:
            raise Broken(_MEMBERS, f"nodes {out} are out")
        # Changes of a step that never begins are told to no node.
        for process in alive if not state.announced else ():
            believed = set(process.state.absent)
            if process.node not in absent and believed != absent:
                seen = f"node {process.node} believes that {sorted(believed)} are out"
                raise Broken(_AGREE, f"{seen}, the environment {sorted(absent)}")
