"""network.json in a run's folder: where a network that runs can be reached."""

from pathlib import Path

import msgspec

NETWORK = "network.json"


class Reach(msgspec.Struct, frozen=True):
    """The run's name, all endpoints to connect to, and its processes by name."""

    run: str
    connect: list[str]
    pids: dict[str, int] = {}


def read_network(folder: Path) -> Reach:
    """Read network.json.

    Raises:
        ValueError: there is none, or it is not one of ours.
    """
    path = folder / NETWORK
    try:
        return msgspec.json.decode(path.read_bytes(), type=Reach)
    except OSError as error:
        raise ValueError(
            f"{path}: cannot be read ({error.strerror}); name the folder of a run over processes"
        ) from None
    except msgspec.MsgspecError as error:
        raise ValueError(f"{path}: not what a launcher writes ({error})") from None
