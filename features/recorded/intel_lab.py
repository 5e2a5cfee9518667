"""The sensor network of the Intel Berkeley Research lab: 54 motes of 2004, real links.

Source: Bodik, Hong, Guestrin, Madden, Paskin, Thibaux, Intel Lab Data, 2004, free with credit. The
folder holds `mote_loc.txt` (number, x and y in m) and `connectivity.txt` (sender, receiver, share
of the frames that arrived). A line of another length is a truncated record of the original; the
reader skips it. Mote 0 is the base station, which has no position and is no node. A mote whose
frames no mote hears, or that hears no mote (mote 5), is left out.
"""

from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from concord.topology.adjacency import from_links, links_of
from concord.topology.analysis import components
from concord.topology.network import GraphSource, Network, part_of

# A link delivers at least one frame in ten; the rest is noise of the measurement.
LEAST_DELIVERY = 0.1
LOCATIONS, CONNECTIVITY = "mote_loc.txt", "connectivity.txt"


def intel_lab(folder: str | Path, nodes: int | None = None, *, one_way: bool = False) -> Network:
    """Return the lab's network, of the motes that reach each other.

    Links deliver `LEAST_DELIVERY` or more, both ways, or in at least one direction with `one_way`.
    With `nodes`, so many that reach each other around the middle of the lab.

    Raises:
        ValueError: files are missing or malformed, or there are not so many motes.
    """
    lab = _lab(str(folder), one_way)
    assert lab.positions is not None
    most = len(lab.positions)
    if nodes is None or nodes == most:
        return lab
    if not 1 <= nodes < most:
        raise ValueError(
            f"graph intel-lab with {nodes} nodes: {most} motes reach each other; ask for 1 to "
            f"{most} nodes"
        )
    return part_of(lab, _grown(lab, nodes))


def _grown(lab: Network, nodes: int) -> NDArray[np.intp]:
    """Motes (nodes,), ascending: from the one nearest to the middle outwards, each the nearest of
    those that hear one before and are heard by it."""
    assert lab.positions is not None
    away = np.linalg.norm(lab.positions - lab.positions.mean(axis=0), axis=1)
    mutual = (lab.adjacency.toarray() & lab.adjacency.T.toarray()) | np.eye(len(away), dtype=bool)
    part = np.array([np.argmin(away)])
    while len(part) < nodes:
        reached = np.setdiff1d(np.flatnonzero(mutual[part].any(axis=0)), part)
        part = np.append(part, reached[np.argmin(away[reached])])
    return np.sort(part)


@cache
def _lab(folder: str, one_way: bool) -> Network:
    positions = _locations(Path(folder) / LOCATIONS)
    numbers = sorted(positions)
    index = {number: i for i, number in enumerate(numbers)}
    arrived = np.zeros((len(numbers), len(numbers)))
    for sender, receiver, share in _connectivity(Path(folder) / CONNECTIVITY):
        if sender in index and receiver in index and sender != receiver:
            arrived[index[receiver], index[sender]] = share
    heard = arrived >= LEAST_DELIVERY
    if not one_way:
        heard &= heard.T
    adjacency = from_links(len(numbers), *np.nonzero(heard))
    whole = Network(
        adjacency,
        np.asarray(arrived[links_of(adjacency)]),
        np.array([positions[number] for number in numbers]),
        tuple(map(str, numbers)),
    )
    largest = max(components(adjacency), key=len)
    return part_of(whole, np.array(largest))


def _locations(file: Path) -> dict[int, tuple[float, float]]:
    places = {}
    for where, fields in _records(file):
        try:
            number, x, y = int(fields[0]), float(fields[1]), float(fields[2])
        except (ValueError, IndexError):
            raise ValueError(
                f"{where}: {' '.join(fields)!r} is no mote; give its number, x and y in m"
            ) from None
        places[number] = (x, y)
    if not places:
        raise ValueError(f"{file}: no motes; give the file of the data set")
    return places


def _connectivity(file: Path) -> list[tuple[int, int, float]]:
    found = []
    for where, fields in _records(file):
        if len(fields) != 3:
            continue
        try:
            sender, receiver, share = int(fields[0]), int(fields[1]), float(fields[2])
        except ValueError:
            share = np.nan
            sender = receiver = 0
        if not 0 <= share <= 1:
            raise ValueError(
                f"{where}: {' '.join(fields)!r} is no link; give sender, receiver and the share of "
                "frames that arrived, 0 to 1"
            )
        found.append((sender, receiver, share))
    if not found:
        raise ValueError(f"{file}: no links; give the file of the data set")
    return found


def _records(file: Path) -> list[tuple[str, list[str]]]:
    if not file.is_file():
        raise ValueError(
            f"{file}: no such file; name the folder of the Intel lab data, which holds {LOCATIONS} "
            f"and {CONNECTIVITY}"
        )
    lines = file.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    return [
        (f"{file}:{number}", line.split())
        for number, line in enumerate(lines, start=1)
        if line.strip()
    ]


_FOLDER = (LOCATIONS, CONNECTIVITY), "CONCORD_INTEL_LAB"
BOTH_WAYS = GraphSource("the Intel lab", intel_lab, *_FOLDER)
ONE_WAY = GraphSource("the Intel lab", partial(intel_lab, one_way=True), *_FOLDER)
