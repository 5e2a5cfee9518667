"""Which step is shown, and which moment of its bus cycles, as time goes by."""

from typing import NamedTuple

from concord.dashboard.view import View

# Seconds in which a picture that rests goes through the frames of one cycle.
_SWEEP_S = 2.0
# A network that is faster than the eye shows another moment of its cycle in each picture.
_GLIMPSE_CYCLES = 0.37
# A sweep ends just before the end of the last cycle: its last frame stays lit.
_REST = 0.35


class Extent(NamedTuple):
    """Extent of the recording: steps `first` to `last`.

    `rounds` is the number of cycles in the shown step; `growing` is True while more steps will
    come.
    """

    first: int
    last: int
    rounds: int
    growing: bool


def play_live(view: View, extent: Extent, elapsed_s: float, paused: bool) -> bool:
    """Stay at the newest step unless the user looks at the past; return whether the view moved."""
    before = view.step, view.cursor
    if view.follow:
        view.step = extent.last
    if view.step == before[0]:
        view.cursor = _swept(view.cursor, elapsed_s, extent.rounds)
    else:
        view.cursor = 0.0 if paused else (view.cursor + _GLIMPSE_CYCLES) % (extent.rounds - _REST)
    return _moved(view, extent, before)


def play_recorded(view: View, extent: Extent, elapsed_s: float, time_step_s: float) -> bool:
    """Play at the plant's time times the speed; True where something moved."""
    before = view.step, view.cursor
    end = extent.rounds - 1e-6
    if view.playing:
        place = view.step + view.cursor / extent.rounds + elapsed_s * view.speed / time_step_s
        if view.loop is not None and not view.loop[0] <= place < view.loop[1] + 1:
            place = float(view.loop[0])
        if place >= extent.last + 1:
            view.step, view.cursor = extent.last, end
            view.playing = extent.growing
        else:
            view.step = int(place)
            view.cursor = (place - view.step) * extent.rounds
    elif view.follow:
        view.step, view.cursor = extent.last, end
    else:
        view.cursor = _swept(view.cursor, elapsed_s, extent.rounds)
    return _moved(view, extent, before)


def _swept(cursor: float, elapsed_s: float, rounds: int) -> float:
    """The cursor goes through the cycles of a step once, and rests in the last."""
    return max(cursor, min(cursor + elapsed_s / _SWEEP_S, rounds - _REST))


def _moved(view: View, extent: Extent, before: tuple[int, float]) -> bool:
    view.step = min(max(view.step, extent.first), extent.last)
    return before != (view.step, view.cursor)
