"""Cost of the dashboard: its processor time per update, and the slowdown of a network.

The first figure is measured on a page that draws every panel at 10 Hz from a recorded run, without
a browser. The second is measured on a network that runs with and without a page, in turns, while a
client looks at the page (`benchmarks/onlooker.py`). The one-time cost of attaching is measured
separately.
"""

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import NamedTuple

from benchmarks.measure import BenchmarkFigures, figure, ratio, say
from benchmarks.processor import spent_s
from concord.dashboard.app import Dashboard
from concord.dashboard.serve import open_recording
from concord.nodes.commands import Pause, Resume
from concord.runtime.drivers import drive, over_processes
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.runtime.network.control_client import Client
from concord.runtime.network.network_file import read_network
from concord.runtime.recording import McapRecorder
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup

SIZES = (24, 100, 400)
UPDATES_HZ, SECONDS = 10.0, 4.0
NODES, STEPS, REPETITIONS = 16, 400, 7
_LAST_STEPS = 40
# A page has settled when it takes less than this of a processor beside a network that stands still.
_SETTLED, _SETTLED_S, _LONGEST_S = 0.1, 1.0, 60.0


def main() -> BenchmarkFigures:
    """Print both and return them."""
    results: BenchmarkFigures = {}
    for nodes in SIZES:
        cost = figure(_update_ms(nodes), "ms of processor time per update", "less")
        results[f"dashboard-update-{nodes}"] = cost
        say(
            f"{nodes:>4} nodes: {cost.value:.1f} ms of processor time per update, "
            f"{cost.value * UPDATES_HZ / 10:.0f} % of a core at {UPDATES_HZ:g} Hz"
        )
    setup = _setup(NODES, STEPS)
    runs: dict[bool, list[_Pace]] = {False: [], True: []}
    for number in range(REPETITIONS):
        # The contestant that runs first has the quieter machine, so the order alternates.
        for attached in (False, True) if number % 2 == 0 else (True, False):
            runs[attached].append(_pace(setup, attached))
    return results | _compared(runs[False], runs[True])


class _Pace(NamedTuple):
    """Of a network and its page: steps per second, processor time of each per step, and what the
    page took before it had settled."""

    steps_per_s: float
    network_ms: float
    page_ms: float
    attaching_s: float


def _compared(apart: "list[_Pace]", together: "list[_Pace]") -> BenchmarkFigures:
    """Return the cost of a page, by the clock and by processor time, which other
    processes disturb less."""
    rates = [[run.steps_per_s for run in runs] for runs in (together, apart)]
    costs = [[run.network_ms + run.page_ms for run in runs] for runs in (apart, together)]
    alone = figure(rates[1], "steps per second", "more")
    watched = figure(rates[0], "steps per second", "more")
    kept, cheap = ratio(*rates), ratio(*costs)
    say(
        f"{NODES} nodes in lockstep: {alone.value:.0f} steps per second alone, "
        f"{watched.value:.0f} with a page attached, ratio {kept.value:.2f} "
        f"({kept.low:.2f} to {kept.high:.2f}, {REPETITIONS} in turns)"
    )
    page = figure([run.page_ms for run in together], "ms of processor time per step", "less")
    rate = [run.page_ms * run.steps_per_s for run in together]
    per_s = figure(rate, "ms of processor time per second", "less")
    attaching = figure([run.attaching_s for run in together], "s of processor time", "less")
    say(
        f"     processor time alone to with a page: {cheap.value:.2f} ({cheap.low:.2f} to "
        f"{cheap.high:.2f}), of it the page {page.value:.1f} ms per step or "
        f"{per_s.value:.0f} ms per second ({per_s.low:.0f} to {per_s.high:.0f}); "
        f"to attach {attaching.value:.1f} s once; load {os.getloadavg()[0]:.0f}"
    )
    return {
        "lockstep-alone": alone, "lockstep-watched": watched, "watched-to-alone": kept,
        "watched-to-alone-cost": cheap, "page-per-step": page, "page-per-second": per_s,
        "page-attaching": attaching,
    }  # fmt: skip


def _setup(nodes: int, steps: int) -> Setup:
    # A neighbourhood of a few nodes at every size; half of 24 publish in a cycle, fewer of more.
    defaults = definition_named("target-tracking").defaults
    return prepare(
        defaults.with_(
            nodes=nodes,
            steps=steps,
            graph="4-regular",
            rule="ci",
            number="float64",
            schedule="hybrid",
            occupancy=min(0.5, 12 / nodes),
        )
    )


def _update_ms(nodes: int) -> list[float]:
    """Processor time of one update of everything, at `UPDATES_HZ`."""
    setup = _setup(nodes, 30)
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        recorder = McapRecorder(
            recording, setup.scenario.rounds, setup.time_step_s, frame_format(setup.scenario)
        )
        drive(setup, recorder, lambda _: None)
        recorder.close()
        page = open_recording(setup, recording, "127.0.0.1", 0, light=False)
        try:
            return _paced_ms(page)
        finally:
            page.close()


def _paced_ms(page: Dashboard) -> list[float]:
    clock_s = 1.0
    page.view.playing = page.view.follow = False
    while page.source.pace().state == "LOADING":
        clock_s += 1
        page.tick(clock_s)
    updates = round(SECONDS * UPDATES_HZ)
    began_s = time.monotonic()
    spent_ms: list[float] = []
    spent_s = time.process_time()
    for number in range(updates):
        page.view.step, page.view.cursor = number % len(page.history), 0.5
        page.inputs.select(number % page.stage.nodes)
        # Late enough that every panel is due.
        clock_s += 1
        page.tick(clock_s)
        time.sleep(max(0.0, began_s + (number + 1) / UPDATES_HZ - time.monotonic()))
        # With what the server's own thread has spent on sending.
        spent_ms.append(1e3 * (time.process_time() - spent_s))
        spent_s = time.process_time()
    return spent_ms


def _pace(setup: Setup, attached: bool) -> _Pace:
    """Lockstep rate and cost from when the page is there, or might be, to the end of the run."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        attaching: list[threading.Thread] = []
        marks: list[tuple[int, float]] = []
        begin_s = [float("inf")]
        watched: list[tuple[int, ...]] = []
        spent: list[tuple[int, float, float]] = []

        def weigh(step: int) -> None:
            spent.append((step, spent_s(watched[0]), spent_s(watched[1])))

        def attach() -> None:
            network = read_network(folder)
            client = Client(network.connect, network.run)
            client.command(Pause())
            with _page(folder) if attached else nullcontext(()) as page:
                watched.extend((tuple(network.pids.values()), page))
                _settle(page)
                weigh(marks[-1][0])
                begin_s[0] = time.monotonic()
                client.command(Resume())
                over.wait()
            client.close()

        def on_step(step: int) -> None:
            if not attaching:
                attaching.append(threading.Thread(target=attach))
                attaching[0].start()
            marks.append((step, time.monotonic()))
            # While all are there still.
            if len(spent) == 1 and step >= setup.scenario.steps - _LAST_STEPS:
                weigh(step)

        over = threading.Event()
        run = f"bench-{time.time_ns()}"
        over_processes(setup, run, folder / "run.mcap", None, on_step)
        over.set()
        attaching[0].join()
        measured = [mark for mark in marks if mark[1] > begin_s[0]]
        (first, first_s), (last, last_s) = measured[0], measured[-1]
        (before, network, page), (after, network_end, page_end) = spent
        each_ms = 1e3 / (after - before)
        return _Pace(
            (last - first) / (last_s - first_s),
            each_ms * (network_end - network),
            each_ms * (page_end - page),
            page,
        )


def _settle(page: tuple[int, ...]) -> None:
    """Wait until a page does nothing beside a network that stands still."""
    latest_s = time.monotonic() + _LONGEST_S
    before_s = spent_s(page)
    time.sleep(_SETTLED_S)
    while (now_s := spent_s(page)) - before_s > _SETTLED * _SETTLED_S:
        if time.monotonic() > latest_s:
            raise RuntimeError("a page beside a paused network does not come to rest")
        before_s = now_s
        time.sleep(_SETTLED_S)


@contextmanager
def _page(folder: Path) -> Iterator[tuple[int, ...]]:
    """The process of a page that is attached, as the launcher starts it, and looked at."""
    command = ("dashboard", "--folder", str(folder), "--http-port", "0")
    # In a session of its own, which has a priority of its own.
    page = subprocess.Popen(
        fresh_command("concord.experiments", *command),
        stderr=subprocess.PIPE,
        env=fresh_variables(OPENBLAS_NUM_THREADS="1"),
        start_new_session=True,
    )
    assert page.stderr is not None, "it was started with a pipe"
    url = page.stderr.readline().decode().split()[2]
    onlooker = subprocess.Popen(
        fresh_command("benchmarks.onlooker", url),
        stdout=subprocess.PIPE,
        env=fresh_variables(),
    )
    assert onlooker.stdout is not None, "it was started with a pipe"
    try:
        onlooker.stdout.readline()
        yield (page.pid,)
    finally:
        for process in (onlooker, page):
            process.terminate()
            process.communicate()


if __name__ == "__main__":
    main()
