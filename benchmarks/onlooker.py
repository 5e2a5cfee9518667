"""Client of a page without a browser: it receives every message and draws nothing.

A browser draws on a graphics card, or on another computer; here it would draw on the processors
that are measured. `python -m benchmarks.onlooker URL` looks until it is ended.

Reason for a file of its own: a benchmark starts it as a process.
"""

import sys
from importlib.metadata import version

import msgspec
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

_CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 10.0),
    "fov": 1.0, "near": 0.1, "far": 1000.0, "image_height": 1080, "image_width": 1920,
    "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


def main() -> None:
    """Look until the page or the parent process ends."""
    spoken = Subprotocol(f"viser-v{version('viser')}")
    url = sys.argv[1]
    place, origin = url.replace("http:", "ws:", 1), Origin(url.partition("/?")[0])
    with connect(
        place, origin=origin, subprotocols=[spoken], max_size=None, compression=None
    ) as page:
        # A client counts from its first camera on.
        page.send(msgspec.msgpack.encode(_CAMERA))
        sys.stdout.write("looking\n")
        sys.stdout.flush()
        for _ in page:
            pass


if __name__ == "__main__":
    main()
