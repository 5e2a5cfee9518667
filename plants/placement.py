"""Where to put sensors so that their radios form one network, and sites as one word."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from concord.plants.motion import require_positive
from concord.plants.range_bearing import Moves

GeneratorFor = Callable[[str, int], np.random.Generator]
"""The stream of a purpose ("initial", "process", "measurement") and a node."""


class Draws(NamedTuple):
    """One run's noise in units of its standard deviation."""

    initial: np.ndarray  # (p,)
    process: np.ndarray  # (steps, q)
    measurement: np.ndarray  # (steps, nodes, readings, d)


def standard_draws(
    generator_for: GeneratorFor,
    initial: int,
    process: int,
    measurement: tuple[int, int, int],
    steps: int,
) -> Draws:
    """Draws of the sizes p, q and (nodes, readings, d).

    Every node has a stream of its own and steps come one after the other, so a node's noise depends
    neither on the number of nodes nor on the number of steps.
    """
    nodes, readings, d = measurement
    of_nodes = np.empty((nodes, steps, readings, d))
    for node, noise in enumerate(of_nodes):
        generator_for("measurement", node).standard_normal(out=noise)
    return Draws(
        initial=generator_for("initial", 0).standard_normal(initial),
        process=generator_for("process", 0).standard_normal((steps, process)),
        measurement=of_nodes.swapaxes(0, 1),
    )


ATTEMPTS = 10_000
SITES, FILE = "at:", "file:"
_NEXT, _MOVED = "|", "@"
# So many nodes speak at a time: all pairs of ten thousand would take a gigabyte.
TOGETHER = 64


def place_sensors(
    nodes: int, area_side_m: float = 1000.0, radio_range_m: float = 330.0, drawing: int = 0
) -> NDArray[np.float64]:
    """Positions (nodes, 2) in m, uniform in a square, whose network of radio range is connected.

    A seed s = 0, 1, ... gives `numpy.random.default_rng(s).uniform(0, area_side_m, (nodes, 2))`.
    Drawing 0 is that of the smallest seed whose network is connected, drawing 1 that of the next.

    Raises:
        ValueError: for no nodes, lengths that are not positive, or if the first `ATTEMPTS` seeds
            have too few connected networks (few nodes on a large area).
    """
    if nodes < 1:
        raise ValueError(f"{nodes} sensors: at least 1 must be placed; ask for more nodes")
    if drawing < 0:
        raise ValueError(f"placement {drawing}: must be 0 or more; drawings are counted from 0")
    require_positive(area_side_m=area_side_m, radio_range_m=radio_range_m)
    found = 0
    for seed in range(ATTEMPTS):
        positions = np.random.default_rng(seed).uniform(0, area_side_m, (nodes, 2))
        found += _in_one_piece(positions, radio_range_m)
        if found > drawing:
            return positions
    raise ValueError(
        f"{nodes} sensors on {area_side_m:g} m x {area_side_m:g} m with a radio range of "
        f"{radio_range_m:g} m: {found} placements of the first {ATTEMPTS} seeds are connected, and "
        f"drawing {drawing} is number {drawing + 1}; raise the range, shrink the area or add nodes"
    )


def site_text(placement: str | ArrayLike) -> str:
    """The word for positions (nodes, 2) in m, or for those in a file: `at:120/330;500/210`.

    Args:
        placement: an array, or `file:PATH` of a text file with a line `x, y` for each node; lines
            that begin with # are left out.

    Raises:
        ValueError: a file that cannot be read, or that has other than two finite numbers a line.
    """
    if isinstance(placement, str):
        path = Path(placement.removeprefix(FILE))
        try:
            lines = path.read_text().splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise ValueError(f"placement {placement}: cannot be read ({error})") from None
        rows = [
            _site(f"line {number}", line)
            for number, line in enumerate(lines, start=1)
            if line.strip() and not line.startswith("#")
        ]
    else:
        rows = [_site(f"node {n}", row) for n, row in enumerate(np.atleast_1d(placement))]
    if not rows:
        raise ValueError(f"placement {placement}: has no site; write a line x, y for each node")
    return SITES + ";".join(f"{x!r}/{y!r}" for x, y in rows)


def sites(word: str, nodes: int) -> NDArray[np.float64]:
    """Positions (nodes, 2) in m of a word that `site_text` wrote.

    Raises:
        ValueError: a site that is none, or another number of sites than of nodes.
    """
    if not word.startswith(SITES):
        raise ValueError(
            f"placement {word!r}: is neither the number of a drawing (0, 1, 2, ...), nor "
            "file:PATH with a line x, y in m for each node"
        )
    texts = word.removeprefix(SITES).split(";")
    found = np.array([_site(f"site {n}", text, "/") for n, text in enumerate(texts)])
    if len(found) != nodes:
        raise ValueError(
            f"the placement has {len(found)} sites, and the network {nodes} nodes; give one site "
            "for each node"
        )
    return found


def sites_by_step(word: str, nodes: int) -> tuple[NDArray[np.float64], Moves]:
    """Positions (nodes, 2) in m at the beginning, and those from later steps on, of a word that
    `word_by_step` wrote.

    Raises:
        ValueError: as `sites`.
    """
    first, *later = word.split(_NEXT)
    parts = (one.partition(":") for one in later)
    moves = tuple((int(step), sites(SITES + text, nodes)) for step, _, text in parts)
    return sites(first, nodes), moves


def word_by_step(first: str, later: Iterable[tuple[int, str]]) -> str:
    """The word for sites at the beginning, and others from steps on: `at:0/0;5/5|40:1/0;5/5`."""
    return first + "".join(f"{_NEXT}{step}:{at.removeprefix(SITES)}" for step, at in later)


def stands_by_step(placement: int | str) -> bool:
    """Return whether a placement has other sites in later steps."""
    return isinstance(placement, str) and _NEXT in placement


def is_move(word: str) -> bool:
    """Return whether a word says that some sensors move, and the others stay."""
    return _MOVED in word


def moved_sites(word: str, before: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions (nodes, 2) in m where some sensors have moved from those before: `3@120/450;5@0/9`.

    Raises:
        ValueError: a node that there is not, or a site that is none.
    """
    after = before.copy()
    for move in word.split(";"):
        node, _, at = move.partition(_MOVED)
        if not (node.isdecimal() and int(node) < len(before)):
            raise ValueError(
                f"placement {move!r}: {node!r} is no node of the network; write NODE@x/y with a "
                f"NODE of 0 to {len(before) - 1}"
            )
        after[int(node)] = _site(f"node {node}", at, "/")
    return after


def _site(where: str, given: str | ArrayLike, separator: str = ",") -> tuple[float, float]:
    words = given.split(separator) if isinstance(given, str) else np.ravel(np.asarray(given))
    form = "x, y" if separator == "," else f"x{separator}y"
    try:
        x, y = (float(word) for word in words)
    except (TypeError, ValueError):
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(
            f"placement, {where}: {given!r} is no site; give two finite numbers in m, {form}"
        )
    return x, y


def _in_one_piece(positions: NDArray[np.float64], radio_range_m: float) -> bool:
    """Return whether a message that starts at the first node reaches all others."""
    pending = np.ones(len(positions), dtype=bool)
    pending[0] = False
    front = positions[:1]
    while len(front) and pending.any():
        waiting = np.flatnonzero(pending)
        speaking, front = front[:TOGETHER], front[TOGETHER:]
        offset = positions[waiting, None] - speaking
        near = (offset * offset).sum(axis=-1) <= radio_range_m**2
        heard = waiting[near.any(axis=1)]
        pending[heard] = False
        front = np.concatenate((front, positions[heard]))
    return not pending.any()
