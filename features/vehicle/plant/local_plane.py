"""Latitude and longitude as east and north of a first fix, in metres."""

import numpy as np

EQUATOR_M = 6378137.0
FLATTENING = 1 / 298.257223563


def east_north(
    latitude_rad: np.ndarray, longitude_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """East and north (n,) in m of the first of fixes (n,), on the plane that touches WGS 84 there.

    Fixes are taken to lie on the ellipsoid. A distance d from the first fix comes out too short
    by d^3 / (6 R^2), 4 mm at 10 km. A road at height h above the ellipsoid comes out shorter by
    h / R, 16 mm in 100 m at 1 km.

    Source: National Imagery and Mapping Agency TR8350.2 (2000), WGS 84:
    ellipsoid, and equation 4-14 for Cartesian coordinates, which are turned to east and north.
    """
    square = FLATTENING * (2 - FLATTENING)
    across = EQUATOR_M / np.sqrt(1 - square * np.sin(latitude_rad) ** 2)
    apart = longitude_rad - longitude_rad[:1]
    outward = across * np.cos(latitude_rad) * np.cos(apart)
    east = across * np.cos(latitude_rad) * np.sin(apart)
    axial = (1 - square) * across * np.sin(latitude_rad)
    sine, cosine = np.sin(latitude_rad[:1]), np.cos(latitude_rad[:1])
    return east, cosine * (axial - axial[:1]) - sine * (outward - outward[:1])
