"""Which cycles of a bus that never stops carry the rounds of a run.

The bus counts its cycles from the beginning of the run: cycle b begins at b times the cycle's
length, whether a node sends in it or not. A step at time t has its rounds in consecutive cycles,
the first of which begins at t or later. Nodes number these cycles alone, without the ones between
(`cycle` everywhere else, c = k * rounds + round).

A schedule with turns repeats after `period` cycles. Steps that are a multiple of it apart would
meet the same turn each time, and the nodes of the other turns would never send. So a step begins
with the cycle in which its turn is due: b = c modulo the period. It waits at most period - 1
cycles for that. A step without time for the longest wait begins at once, and hosts reassign
slots so that turns go by rounds.
"""

import copy
from math import ceil, floor, inf
from typing import Protocol, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

# Times are products of decimals: a cycle that is late by less than this part of itself is in time.
_ROUNDING_CYCLES = 1e-6


class Pace(msgspec.Struct, frozen=True):
    """Steps of a run: `rounds` cycles in each, every `step_us`; step `first_step` is the first at
    this pace, and its rounds begin with the nodes' cycle `first_cycle`."""

    step_us: float
    rounds: int
    first_step: int = 0
    first_cycle: int = 0


class Timebase(msgspec.Struct, frozen=True):
    """The cycles of a bus that carry rounds.

    Attributes:
        cycle_us: length of a cycle; 0 on a bus without time, whose cycles all carry rounds.
        period: cycles after which the schedule repeats.
        pace: of the run; None for a bus that is used in every cycle.
    """

    cycle_us: float = 0.0
    period: int = 1
    pace: Pace | None = None

    def bus_cycle(self, cycle: int) -> int:
        """Return the number on the bus of the cycle that nodes call `cycle`."""
        if self.pace is None or not self.cycle_us:
            return cycle
        step, number = self._place(self.pace, cycle)
        return self._first_of(self.pace, step) + number

    def begins_us(self, cycle: int) -> float:
        """Return when the cycle that nodes call `cycle` begins, from the beginning of the run."""
        return self.bus_cycle(cycle) * self.cycle_us

    def wait_us(self, step: int) -> float:
        """Return the time from the sampling instant of a step to the cycle of its first round."""
        if self.pace is None or not self.cycle_us:
            return 0.0
        wait_us = self._first_of(self.pace, step) * self.cycle_us - step * self.pace.step_us
        return max(0.0, wait_us)

    def cycles_of(self, steps: int) -> float:
        """Return how many cycles pass in so many steps; those of the rounds without time."""
        if self.pace is None or not self.cycle_us:
            return float(steps * (1 if self.pace is None else self.pace.rounds))
        return steps * self.pace.step_us / self.cycle_us

    def ages_over_all(self, ages: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return ages of shares in cycles of the bus, also those that carry no round.

        `ages` (..., steps, K) are those after the last round of each step from step 0 on, in cycles
        that carry rounds; -1 is never and stays.
        """
        if self.pace is None:
            return ages
        steps, rounds = ages.shape[-2], self.pace.rounds
        numbers = np.array([self.bus_cycle(cycle) for cycle in range(steps * rounds)], dtype=int)
        last = np.arange(1, steps + 1)[:, None] * rounds - 1
        then = numbers[np.clip(last - ages, 0, len(numbers) - 1)]
        return np.where(ages < 0, -1, numbers[last] - then)

    @property
    def waits_for_turn(self) -> bool:
        """Whether a step has time to wait for the cycle in which its turn is due."""
        if self.pace is None:
            return True
        return self._least_cycles(self.pace) >= self.pace.rounds + self.period - 1

    @property
    def keeps_turns(self) -> bool:
        """Whether turns go by the cycles of the bus, so that controllers can multiplex them."""
        if self.pace is None or not self.cycle_us or self.waits_for_turn:
            return True
        cycles = self.pace.step_us / self.cycle_us
        is_whole = abs(cycles - round(cycles)) < _ROUNDING_CYCLES
        return is_whole and (round(cycles) - self.pace.rounds) % self.period == 0

    def _place(self, pace: Pace, cycle: int) -> tuple[int, int]:
        """The step of a nodes' cycle, and the number of its round."""
        steps, number = divmod(cycle - pace.first_cycle, pace.rounds)
        return pace.first_step + steps, number

    def _first_of(self, pace: Pace, step: int) -> int:
        """The number on the bus of the cycle of a step's first round."""
        earliest = ceil(step * pace.step_us / self.cycle_us - _ROUNDING_CYCLES)
        if not self.waits_for_turn:
            return earliest
        turn = pace.first_cycle + (step - pace.first_step) * pace.rounds
        return earliest + (turn - earliest) % self.period

    def _least_cycles(self, pace: Pace) -> float:
        """Whole cycles that every step has time for."""
        return floor(pace.step_us / self.cycle_us + _ROUNDING_CYCLES) if self.cycle_us else inf


EVERY_CYCLE = Timebase()
"""Of a bus whose cycles all carry rounds."""


class Cyclic(Protocol):
    """A bus that repeats its cycle and has a time base."""

    timebase: Timebase

    @property
    def cycle_us(self) -> float:
        """Return the length of a cycle; 0 on a bus without time."""
        ...


AnyCyclic = TypeVar("AnyCyclic", bound=Cyclic)


def at_pace(bus: AnyCyclic, pace: Pace, period: int) -> AnyCyclic:
    """Return the bus in a run of this pace; its slots repeat after `period` cycles."""
    other = copy.copy(bus)
    other.timebase = Timebase(bus.cycle_us, period, pace)
    return other
