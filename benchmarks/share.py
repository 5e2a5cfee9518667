"""Time to encode a share into its frame and to decode it, with checksums."""

import time
from collections.abc import Callable

from benchmarks.cases import turn
from benchmarks.measure import BenchmarkFigures, figure, in_turns, say
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import full_publish
from concord.nodes.vector_codec import BeliefCodec

TURNS, TIMES = 20, 1_000


def main() -> BenchmarkFigures:
    """Print and return microseconds per share of five states in one frame."""
    belief = turn().start
    codec = BeliefCodec(len(belief.mean))
    bus = TimelessBus(full_publish(1), codec.size)
    (frame,) = bus.encode(0, 7, codec.encode(belief))

    def encode() -> None:
        bus.encode(0, 7, codec.encode(belief))

    def decode() -> None:
        body = bus.due_body(frame, 0, 7, codec.size)
        assert body is not None, "what is sent is what is due"
        codec.decode(body)

    def decode_any() -> None:
        codec.decode(bus.frame_format.join([bus.receive(frame).data]))

    contestants = {"encode": encode, "decode": decode, "decode at any time": decode_any}
    times = in_turns({name: _timed(work) for name, work in contestants.items()}, TURNS)
    results = {
        f"{name} us": figure([1e6 * one for one in given], "us", "less")
        for name, given in times.items()
    }
    said = ", ".join(f"{name[:-3]} {one.value:.1f}" for name, one in results.items())
    say(f"a share of {codec.size} bytes with its checksums, us of the processor: {said}")
    return results


def _timed(work: Callable[[], None]) -> Callable[[], float]:
    def run() -> float:
        started = time.process_time()
        for _ in range(TIMES):
            work()
        return (time.process_time() - started) / TIMES

    return run


if __name__ == "__main__":
    main()
