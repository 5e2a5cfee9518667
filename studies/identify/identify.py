"""Identify noise, delays and parameters of a scenario, and judge its readings before and after.

The parts are `readings` (what is heard), `likelihood` (of values) and `fit` (the likeliest).
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from concord.disk import writing
from concord.plants.recorded.channels import earlier
from concord.results.verdict.judge import judged_innovations
from concord.scenarios.catalogue import beside_truth, definition_of, scored_nees
from concord.scenarios.innovations import innovations_of_all
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.identified_values import (
    DELAY,
    THETA,
    Q,
    R,
    in_toml,
    values_in,
    word_of,
)
from concord.studies.identify.fit import FoundValue, SoughtValue, ValueFit, usual_steps
from concord.studies.identify.readings import HeardReadings, readings_of

_FACTORS = (1e-4, 1e4)
JUDGED_STEPS = 20_000
"""Of a longer log the verdict judges so many of the first steps."""


class Judgement(msgspec.Struct, frozen=True):
    """NIS per entry with its interval, ANEES beside the truth, and the sentence of the verdict, of
    the filter that hears everything; None for what is not known."""

    nis: float | None
    nis_interval: tuple[float, float] | None
    anees: float | None
    said: str


class Identification(msgspec.Struct, frozen=True):
    """The result of `concord identify`.

    Attributes:
        found: each value that was sought.
        values: what filters shall believe, by name: all that was told, and what they believed
            before.
        before, after: the verdict on the readings; none after an interrupt.
        left: parameters that the scenario declares, and nobody sought.
        updates: number of entries that were read.
        ended: whether the fit came to its end.
    """

    found: tuple[FoundValue, ...]
    values: dict[str, float]
    before: Judgement
    after: Judgement | None
    left: tuple[str, ...]
    updates: int
    ended: bool

    @property
    def word(self) -> str:
        """The values in one word, for the option `identified` of a scenario."""
        return word_of(self.values)

    def interval(self, one: FoundValue) -> str:
        """The interval of a value in words; empty where it was not told, and after an interrupt."""
        return f"{one.low:.4g} to {one.high:.4g}" if one.told and self.ended else ""

    def write(self, file: Path) -> None:
        """Write the file that `--identified` takes.

        Raises:
            ValueError: it cannot be written.
        """
        untold = "the log does not tell it"
        notes = {one.name: self.interval(one) if one.told else untold for one in self.found}
        with writing(file):
            file.write_text(in_toml(self.values, notes), encoding="utf-8")


def identify(
    scenario: Scenario,
    seek: Sequence[str] = (),
    on_step: Callable[[int, int], None] = lambda done, most: None,
) -> Identification:
    """Return the likeliest values of a scenario's readings.

    Args:
        scenario: with readings of a log, or simulated ones; what it believes is the start.
        seek: names of values; all R and Q when left out.
        on_step: told how many steps of passes are done, of how many. No fit knows how many passes
            it needs, so the second number grows by a pass where the usual ones are over.

    Raises:
        ValueError: a name that the scenario does not have, or a scenario that cannot be identified.
    """
    log, start = readings_of(scenario), values_in(scenario.identified)
    names = [log.known.found(one) for one in seek]
    names = names or [one for one in log.known.names if one.startswith((f"{R}.", f"{Q}."))]
    if len(set(names)) < len(names):
        raise ValueError(f"--seek {','.join(names)}: a name is there twice; give each once")
    done, most = 0, usual_steps(log.steps)

    def on_steps(steps: int) -> None:
        nonlocal done, most
        done += steps
        if done >= most:
            most += log.steps
        on_step(done, most)

    delays = [one for one in names if one.startswith(f"{DELAY}.")]
    sought = [_sought(log, name, start) for name in names if name not in delays]
    before = judged(log, scenario)
    fit = ValueFit(log, sought, delays, start, on_steps)
    ended = fit.run()
    found = fit.found()
    values = start | {one.name: one.value for one in found if one.told}
    told = scenario.with_(identified=word_of(values))
    after = judged(log, told) if ended else None
    if ended:
        on_step(most, most)
    updates = int(np.isfinite(log.values).sum())
    left = tuple(one for one in log.known.names if one.startswith(f"{THETA}.") and one not in names)
    return Identification(found, values, before, after, left, updates, ended)


def _sought(log: HeardReadings, name: str, start: dict[str, float]) -> SoughtValue:
    table, _, rest = name.partition(".")
    if table != THETA:
        return SoughtValue(name, start.get(name, 1.0), *_FACTORS)
    assert log.known.declared is not None, "the name was found"
    value, low, high = log.known.declared.parameters[rest]
    return SoughtValue(name, start.get(name, value), low, high)


def judged(log: HeardReadings, scenario: Scenario) -> Judgement:
    """The verdict on the readings by the filter that hears everything, as a scenario believes."""
    log = log.cut(JUDGED_STEPS)
    setup = msgspec.structs.replace(
        log.setup, scenario=scenario.with_(filter="ukf", identified=scenario.identified)
    )
    moves = log.moves(values_in(scenario.identified))
    values = earlier(log.values, moves.tolist())[None]
    heard = innovations_of_all(setup, [scenario.run], values, None)
    assert heard is not None, "readings_of has looked"
    score = definition_of(scenario).score
    counted = np.arange(log.steps)[None] >= min(score.first_step, log.steps // 2)
    errors = beside_truth(scenario, heard.belief.mean, log.truth[None]) - log.truth
    nees = scored_nees(scenario, errors, heard.belief.cov) / len(score.nees_states)
    figures, finding = judged_innovations(
        setup, heard.innovations, heard, counted, nees, explain=False, nees_centre=nees
    )
    known = nees[counted & np.isfinite(nees)]
    anees = float(known.mean()) if len(known) else None
    return Judgement(figures.centralised.nis, figures.centralised.interval, anees, finding.said)
