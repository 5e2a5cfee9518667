"""The Cholesky factor of one small matrix in plain numbers.

For a few rows numpy takes twice as long to call LAPACK as Python takes to do its work.
"""

import math

ROWS = 5

Rows = list[list[float]]
Factor = tuple[tuple[float, ...], ...]


def plain_cholesky(matrix: Rows) -> Factor:
    """Lower triangular factor of a symmetric matrix of up to ROWS rows, of which the lower triangle
    is read; NaN is carried through to the last pivot.

    Raises:
        ValueError: a pivot is negative.
        ZeroDivisionError: a pivot but the last is zero.
    """
    n, root = len(matrix), math.sqrt
    p = matrix[0]
    l00 = root(p[0])
    if n == 1:
        return ((l00,),)
    p = matrix[1]
    l10 = p[0] / l00
    l11 = root(p[1] - l10 * l10)
    if n == 2:
        return (l00, 0.0), (l10, l11)
    p = matrix[2]
    l20 = p[0] / l00
    l21 = (p[1] - l20 * l10) / l11
    l22 = root(p[2] - l20 * l20 - l21 * l21)
    if n == 3:
        return (l00, 0.0, 0.0), (l10, l11, 0.0), (l20, l21, l22)
    p = matrix[3]
    l30 = p[0] / l00
    l31 = (p[1] - l30 * l10) / l11
    l32 = (p[2] - l30 * l20 - l31 * l21) / l22
    l33 = root(p[3] - l30 * l30 - l31 * l31 - l32 * l32)
    first = (l00, 0.0, 0.0, 0.0), (l10, l11, 0.0, 0.0), (l20, l21, l22, 0.0), (l30, l31, l32, l33)
    if n == 4:
        return first
    p = matrix[4]
    l40 = p[0] / l00
    l41 = (p[1] - l40 * l10) / l11
    l42 = (p[2] - l40 * l20 - l41 * l21) / l22
    l43 = (p[3] - l40 * l30 - l41 * l31 - l42 * l32) / l33
    l44 = root(p[4] - l40 * l40 - l41 * l41 - l42 * l42 - l43 * l43)
    return *((*row, 0.0) for row in first), (l40, l41, l42, l43, l44)
