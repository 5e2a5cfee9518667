"""Shapes as arrays: ellipses of covariances, dashes, unit meshes. Leading axes are free."""

import numpy as np

SEGMENTS = 40


def ellipse_axes(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half-axes (..., 2), the longer first, and its angle (...,) in rad of covariances (..., 2, 2).

    The half-axes are those of one standard deviation.
    """
    values, vectors = np.linalg.eigh(0.5 * (cov + cov.mT))
    half = np.sqrt(np.maximum(values[..., ::-1], 0.0))
    longest = vectors[..., :, 1]
    return half, np.arctan2(longest[..., 1], longest[..., 0])


def about_vertical(angle: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4), w first, of turns by `angle` about the vertical."""
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, zero, np.sin(angle / 2)], axis=-1)


def outlines(
    centre: np.ndarray, half: np.ndarray, angle: np.ndarray, count: int = SEGMENTS
) -> np.ndarray:
    """Outlines (..., count, 2, 2) as segments of ellipses with centre (..., 2), half (..., 2)."""
    turn = np.linspace(0.0, 2 * np.pi, count + 1)
    along = half[..., :1] * np.cos(turn)
    across = half[..., 1:] * np.sin(turn)
    cosine, sine = np.cos(angle)[..., None], np.sin(angle)[..., None]
    points = np.stack(
        [
            centre[..., :1] + along * cosine - across * sine,
            centre[..., 1:] + along * sine + across * cosine,
        ],
        axis=-1,
    )
    return np.stack([points[..., :-1, :], points[..., 1:, :]], axis=-2)


def path(points: np.ndarray) -> np.ndarray:
    """Segments (P - 1, 2, d) that join points (P, d)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def dashed(segments: np.ndarray, dashes: int = 5) -> np.ndarray:
    """Each of segments (S, 2, d) as dashes with gaps: (S dashes, 2, d)."""
    ends = np.linspace(0.0, 1.0, 2 * dashes)
    start, end = ends[0::2], ends[1::2]
    first, way = segments[:, None, 0], segments[:, None, 1] - segments[:, None, 0]
    pieces = np.stack([first + start[:, None] * way, first + end[:, None] * way], axis=2)
    return pieces.reshape(-1, 2, segments.shape[-1])


def disc(count: int = 36) -> tuple[np.ndarray, np.ndarray]:
    """A flat unit disc: vertices (V, 3) and faces (F, 3)."""
    turn = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=-1)
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], rim])
    following = np.roll(np.arange(1, count + 1), -1)
    faces = np.stack([np.zeros(count, int), np.arange(1, count + 1), following], axis=-1)
    return vertices, faces.astype(np.uint32)


def ring(inner: float = 0.82, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """A flat ring of outer radius 1: vertices (V, 3) and faces (F, 3)."""
    turn = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=-1)
    vertices = np.concatenate([rim, inner * rim])
    here, following = np.arange(count), np.roll(np.arange(count), -1)
    outer = np.stack([here, following, here + count], axis=-1)
    inside = np.stack([following, following + count, here + count], axis=-1)
    return vertices, np.concatenate([outer, inside]).astype(np.uint32)


def sphere() -> tuple[np.ndarray, np.ndarray]:
    """A unit sphere: vertices (V, 3) and faces (F, 3)."""
    rows, columns = 9, 16
    up = np.linspace(-np.pi / 2, np.pi / 2, rows)
    around = np.linspace(0.0, 2 * np.pi, columns, endpoint=False)
    height, turn = np.meshgrid(up, around, indexing="ij")
    vertices = np.stack(
        [np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.sin(height)], axis=-1
    ).reshape(-1, 3)
    here = np.arange(rows * columns).reshape(rows, columns)
    right = np.roll(here, -1, axis=1)
    lower = np.stack([here[:-1], right[:-1], right[1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([here[:-1], right[1:], here[1:]], axis=-1).reshape(-1, 3)
    return vertices, np.concatenate([lower, upper]).astype(np.uint32)


def post() -> tuple[np.ndarray, np.ndarray]:
    """A box of width 1 from height 0 to 1: vertices (8, 3) and faces (12, 3)."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)], float)
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    return corners, np.array(faces, dtype=np.uint32)


def zonotope_corners(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """Corners (2q, 2), in order round about, of {centre (2,) + generators (2, q) c : |c_i| <= 1}.

    Its edges are the generators, twice each, in order of their direction.
    """
    upward = np.where((generators[1] < 0) | ((generators[1] == 0) & (generators[0] < 0)), -1.0, 1.0)
    turned = generators * upward
    edges = 2 * turned[:, np.argsort(np.arctan2(turned[1], turned[0]), kind="stable")]
    lowest = centre - turned.sum(axis=1)
    up = lowest + np.cumsum(edges.T, axis=0)
    # The other half is the same, point by point through the centre.
    return np.concatenate([up, 2 * centre - up])
