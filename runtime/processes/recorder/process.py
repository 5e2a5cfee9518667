"""The recorder process: it keeps the messages of all others, and lets subscribers hear them."""

import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from types import FrameType

import msgspec

from concord.nodes.bounds import UNREADABLE, node_of
from concord.nodes.changes import Event, Left
from concord.nodes.messages import END, MalformedMessage, decode, is_topic
from concord.runtime.network.links import RECORDER, WATCH, ZenohEndpoints
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.peer_timeout import DepartedPeers
from concord.runtime.processes.recorder.subscribers import Subscribers
from concord.runtime.processes.republisher import AGAIN, KEEP, Deduplication
from concord.runtime.recording import Recorder
from concord.runtime.whole_steps import WholeSteps

# A message that waits takes some 9 kB, however short it is: zenoh keeps what it came in.
RECORDER_QUEUE = 8192
# A node that was away for so long says nothing more.
_GRACE_S = 2.0
# Messages on topics that belong to no process are kept under this name.
STRANGE = "strange"
# Through a router the recorder hears itself, too.
_UNRECORDED = ("hello", "recorded", "start", "end", AGAIN, WATCH)
_ONCE_MORE, _AGAIN = f"{KEEP}/", f"{AGAIN}/"


class Finished(msgspec.Struct, frozen=True):
    """Environment to recorder: nothing more will come but the last estimates of these nodes."""

    step: int
    members: list[int]


class _Estimated(msgspec.Struct):
    step: int


_estimated = msgspec.json.Decoder(_Estimated)


def run_recorder(
    run: str,
    links: ZenohEndpoints,
    watch: ZenohEndpoints,
    recorder: Recorder,
    steps: WholeSteps,
    on_end: Callable[[int], None] = lambda repeated: None,
) -> None:
    """Record every message until the environment has finished and all last estimates have come.

    Subscribers hear recorded messages on `watch`, message by message and in whole `steps`. `on_end`
    is told how many messages processes have repeated for each other.

    Raises:
        LinkError: the network cannot be joined.
    """
    transport = Transport(run, links, ["**"], RECORDER_QUEUE, answers=True)
    subscribers = Subscribers(Transport(run, watch, [], 1), steps, lambda: transport.wake("**"))
    transport.join(RECORDER, set())
    ends, remembered = _Ends(transport, steps.nodes), Deduplication()
    told = _told_to_end(lambda: transport.wake("**"))
    finished: Finished | None = None
    latest: dict[int, int] = {}
    leaving: dict[int, int] = {}
    topics: set[str] = set()
    repeated = 0
    while not told.is_set() and not (finished and _complete(finished, latest, ends.silent)):
        received, is_woken = transport.receive_all("**")
        received = remembered.what_is_new(received, _ONCE_MORE)
        repeated += sum(name.startswith(_AGAIN) for name, _ in received)
        kept = list(_to_be_kept(received, steps.nodes, topics))
        recorder.record(kept)
        subscribers.tell(kept)
        # Bytes from a sender that obeys no rule are kept as received; they change nothing here.
        for name, data in kept:
            with suppress(*UNREADABLE, MalformedMessage):
                if name.startswith("estimate/"):
                    owner, step = int(name.partition("/")[2]), _estimated.decode(data).step
                    latest[owner] = max(step, latest.get(owner, -1))
                elif name == "event":
                    leaving |= _leaving(decode(name, data))
        for name, data in received:
            finished = _finished(name, data) or finished
        for out in [i for i, step in leaving.items() if step < 0 or latest.get(i) == step]:
            # A node that leaves on command may end now: none of its messages will be lost.
            transport.send(f"recorded/{out}", b"{}")
            del leaving[out]
        if is_woken:
            ends.look()
            subscribers.look()
    recorder.close()
    on_end(repeated)
    if told.is_set():
        # The launcher process ends all others; this one has kept what it was there for.
        return
    transport.send("end", END)
    subscribers.close()
    transport.close()


def _told_to_end(wake: Callable[[], None]) -> threading.Event:
    """Return what is set when the launcher process asks this one to end, by SIGTERM."""
    told = threading.Event()

    def note(_signal: int, _frame: FrameType | None) -> None:
        told.set()
        # In a thread: this one may hold the lock that `wake` takes.
        threading.Thread(target=wake, daemon=True).start()

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, note)
    return told


def _to_be_kept(
    received: Sequence[tuple[str, bytes]], nodes: int, topics: set[str]
) -> Iterator[tuple[str, bytes]]:
    """Those of messages (topic, bytes) that are recorded, under the names that they have there;
    `topics` are names that were looked at before, and are added to."""
    for name, data in received:
        if name not in topics:
            if name.partition("/")[0] in _UNRECORDED or _finished(name, data):
                continue
            # Of names there is no end; of channels in a file there is.
            if not is_topic(name, nodes):
                yield STRANGE, data
                continue
            topics.add(name)
        yield name, data


def _finished(name: str, data: bytes) -> Finished | None:
    """Decode the environment's last message; None if it is another."""
    if name == "finished":
        with suppress(*UNREADABLE):
            return msgspec.json.decode(data, type=Finished)
    return None


class _Ends:
    """Nodes whose last word has come, as they are gone and no link brings them back."""

    def __init__(self, transport: Transport, nodes: int) -> None:
        self._nodes = nodes
        self.silent: set[int] = set()
        self._transport = transport
        self._departed = DepartedPeers(_GRACE_S, lambda name: self._note(int(name), is_there=False))
        self._seen: deque[tuple[int, bool]] = deque()
        transport.watch(self._see)

    def _see(self, name: str, is_there: bool) -> None:
        """In zenoh's thread."""
        node = node_of(name, self._nodes)
        if node is not None:
            self._departed.see(name, is_there)
            if is_there:
                self._note(node, is_there=True)

    def _note(self, node: int, *, is_there: bool) -> None:
        """Earlier messages of the node are ahead of this call in the queue."""
        self._seen.append((node, is_there))
        self._transport.wake("**")

    def look(self) -> None:
        """Take the ends that were noted: all messages before them have been heard."""
        while self._seen:
            node, is_there = self._seen.popleft()
            (self.silent.discard if is_there else self.silent.add)(node)


def _leaving(event: Event) -> dict[int, int]:
    """The node that leaves on command, and the last step that it has estimated."""
    return {event.change.node: event.step - 1} if isinstance(event.change, Left) else {}


def _complete(finished: Finished, latest: dict[int, int], silent: set[int]) -> bool:
    """Whether the last estimate of every node has come that may still say something."""
    members = (node for node in finished.members if node not in silent)
    return all(latest.get(node) == finished.step for node in members)
