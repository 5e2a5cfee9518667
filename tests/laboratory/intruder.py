"""An intruder without keys at one process of a network, and the messages that it can send."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from concord.nodes.commands import Answer
from concord.nodes.messages import END
from concord.runtime.network.links import ENVIRONMENT, RECORDER
from tests.laboratory.malformed import DAMAGED, FRAMES, JSON, MISFITS, WHOLE, Spoil
from tests.laboratory.running import stranger

ASK_S = 10.0
GONE = b'{"what":"gone","node":1}'
GRANT = b'{"cycle":1,"winners":[0]}'
BID = b'{"node":1,"cycle":1,"bid":7,"payload_bytes":24}'
LOST = b'{"node":1,"neighbour":2}'
TIMING = b'{"node":1,"step":0,"heartbeat_late_s":null,"cycle_late_s":[]}'
CUT = b'{"step":0,"change":{"what":"cut","sender":0,"receiver":1}}'
WELCOME = b'{"node":0,"step":0,"standing":{},"joined":{"what":"joined","node":0}}'
ROUNDS = [
    b'{"step":0,"change":{"what":"settings","settings":{"rounds":%b},"first_cycle":0}}' % rounds
    for rounds in (b"0", b"-1", b'"x"', b"1e300", b"0.5")
]
# No node has one of these names.
NAMES = ("9" * 5000, "\u0663", "\u00b2", "01", "-1", "+1", "1e0", "1 ", "\x01\u202e\n", "\u2603")
COMMANDS = [
    b"\xff", b"[" * 4000, b"x" * 5000, b'{"do":"pause","x":' + b"[" * 4000, b"{}", b"null",
    b'{"do":"speed","steps_per_second":1e-300}', b'{"do":"speed","steps_per_second":NaN}',
    b'{"do":"speed","steps_per_second":1e999}', b'{"do":"step","count":0}', b'{"do":"kill"}',
    b'{"do":"kill","node":99999999999999999999}', b'{"do":"restart","node":-1}',
    b'{"do":"cut","sender":-1,"receiver":0}', b'{"do":"loss","probability":1e308}',
    b'{"do":"partition","nodes":[]}', b'{"do":"fault","kind":"\\u0000"}',
    b'{"do":"fault","kind":"bias","nodes":[1],"numbers":[1e308,1,2,3]}',
    b'{"do":"set","settings":{"rounds":1e300}}', b'{"do":"set","settings":{"rule":"\\ud800"}}',
    b'{"do":"set","settings":{"occupancy":-1}}', b'{"do":"set","settings":{"rule":0}}',
]  # fmt: skip


class Said(NamedTuple):
    """Messages of one topic: sound ones, and the ways to spoil them."""

    topic: str
    whole: Sequence[bytes]
    ways: tuple[Spoil, ...]


class Intruder:
    """At one process; `said` is what it can be told, in turn."""

    def __init__(self, run: str, name: str, port: int, said: list[Said]) -> None:
        self.name, self.said = name, said
        self.transport = stranger(run, port)

    def pose(self) -> None:
        """Be ready under names that no node has."""
        for name in NAMES:
            self.transport.join(name, {name})

    def command(self, number: int) -> bool:
        """Ask for what cannot be; whether it was refused."""
        answer = self.transport.ask("control", COMMANDS[number % len(COMMANDS)], ASK_S)
        return answer is not None and not msgspec.json.decode(answer, type=Answer).accepted


def to_node(node: int, neighbours: Sequence[int], heard: dict[str, list[bytes]]) -> list[Said]:
    """Return messages for the topics of a node; the steps of all `heard` messages are over."""
    said = [Said(f"share/{j}", heard[f"share/{j}"], FRAMES) for j in neighbours]
    said += [Said(f"measured/{node}", heard[f"measured/{node}"], (*JSON, *MISFITS))]
    said += [Said("grant", [GRANT], (*JSON, *WHOLE)), Said("end", [END], (*JSON, *WHOLE))]
    return (
        said
        + [Said(topic, [GONE], JSON) for topic in ("gone", f"gone/{node}")]
        + [Said(f"welcome/{node}", [WELCOME], (*JSON, *WHOLE))]
    )


def to_world(nodes: int, heard: dict[str, list[bytes]]) -> list[Said]:
    """Return messages for the topics of an environment without contenders for dynamic slots."""
    said = [Said(f"estimate/{i}", heard[f"estimate/{i}"], (*JSON, *WHOLE)) for i in range(nodes)]
    said += [Said(f"estimate/{name}", heard["estimate/0"], (*JSON, *WHOLE)) for name in NAMES]
    said += [Said("bid/1", [BID], (*JSON, *WHOLE)), Said("bid/0", [BID], (*JSON, *WHOLE))]
    said += [Said("hello/1", [b"0" * 63 + b"g", b"0" * 64], WHOLE), Said("hello/1", [LOST], JSON)]
    said += [Said(f"hello/{name}", [b"0" * 64], WHOLE) for name in NAMES]
    said += [Said(f"recorded/{name}", [END], WHOLE) for name in ("1", *NAMES)]
    return [*said, Said("unreachable/1", [LOST], JSON), Said("end", [END], (*JSON, *WHOLE))]


def to_recorder(nodes: int, heard: dict[str, list[bytes]]) -> list[Said]:
    """Return messages for the recorder, which subscribes to every topic."""
    said = [Said(f"share/{i}", heard[f"share/{i}"], DAMAGED) for i in range(nodes)]
    said += [Said(f"estimate/{i}", heard[f"estimate/{i}"], JSON) for i in range(nodes)]
    said += [Said(f"{kind}/{name}", [END], WHOLE) for kind in ("share", "gone") for name in NAMES]
    said += [
        Said(name, [END], (*JSON, *WHOLE)) for name in ("finished", "nobody", "strange", *NAMES)
    ]
    said += [Said("event", [CUT], JSON), Said("event", ROUNDS, WHOLE), Said("truth", [CUT], JSON)]
    said += [Said("bid/1", [BID], JSON), Said("grant", [GRANT], JSON), Said("gone", [GONE], JSON)]
    return [*said, Said("unreachable/1", [LOST], JSON), Said("timing/1", [TIMING], JSON)]


def intruders(
    run: str,
    neighbours: Sequence[Sequence[int]],
    ports: dict[str, int],
    sound: list[tuple[str, bytes]],
) -> list[Intruder]:
    """One at each process; `sound` is what sound ones have said."""
    heard: dict[str, list[bytes]] = {}
    for topic, data in sound:
        # Those of the first steps are over when the storm begins.
        heard.setdefault(topic, [])
        if len(heard[topic]) < 5:
            heard[topic].append(data)
    nodes = len(neighbours)
    told = {str(i): to_node(i, neighbours[i], heard) for i in range(nodes)}
    told |= {ENVIRONMENT: to_world(nodes, heard), RECORDER: to_recorder(nodes, heard)}
    return [Intruder(run, name, ports[name], said) for name, said in told.items()]
