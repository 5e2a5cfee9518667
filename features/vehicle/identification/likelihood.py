"""Likelihood of the innovations of a drive, its gradient, and its Fisher information.

The innovations v with covariance S are those of the filter that hears every sensor of
`vehicle-network`, and the side slip where it is logged. With the negative logarithm
L = sum (log det S + v' S^-1 v) / 2 and derivatives v_i, S_i by parameter i:

    g_i  = sum tr(S^-1 S_i) / 2 + v' S^-1 v_i - v' S^-1 S_i S^-1 v / 2
    M_ij = sum tr(S^-1 S_i S^-1 S_j) / 2 + v_i' S^-1 v_j

Source: Gupta and Mehra (1974), Computational aspects of maximum likelihood estimation and reduction
in sensitivity function calculations. Derivatives are differences between lanes of one batch.
"""

from typing import NamedTuple

import numpy as np

from concord.features.vehicle.identification.lane_filter import LaneFilter
from concord.features.vehicle.identification.logged_readings import LoggedReadings
from concord.features.vehicle.identification.sought import Sought, car_with
from concord.features.vehicle.plant.model import Tyre
from concord.features.vehicle.plant.parameters import Car


def scatter_of(scores: np.ndarray, lags: int) -> np.ndarray:
    """The covariance (p, p) of the sum of scores (n, p) that correlate over so many samples.

    It is larger by what its own error asks, so that intervals with the quantiles of the normal
    distribution hold in 95 %: one drive tells it to a tenth or two.

    Sources: Newey and West (1987), A simple, positive semi-definite, heteroskedasticity and
    autocorrelation consistent covariance matrix; Kiefer and Vogelsang (2005), A new asymptotic
    theory for heteroskedasticity-autocorrelation robust tests, for the quantile.
    """
    total = scores.T @ scores
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        product = scores[:-lag].T @ scores[lag:]
        total += (1 - lag / (lags + 1)) * (product + product.T)
    share = min(1.0, (lags + 1) / len(scores))
    quantile = np.polyval([-0.5324, 0.4160, 2.9694, 1.9600], share)
    return (quantile / 1.9600) ** 2 * total


DIFFERENCE = 1e-5
"""Of a parameter, in spreads."""
CORRELATED_S = 0.25
"""Scores that are so near count as correlated: the time in which errors of the model change."""
_WIDTHS, _RISE = (1, 2, 4, 8), 4.0
"""Samples over which differences by a delay may reach, and by how much the logarithm of the
likelihood must fall there on average: more than by the noise of readings that meet others."""


class Likelihood(NamedTuple):
    """Negative logarithm of the likelihood; gradient (p,) and information (p, p) in spreads.

    `scatter` (p, p) is the covariance of the gradient as the scores of the samples have it, and
    more, as they are few. Information is about equal to it where the model is right.

    The information of a delay is that of a smooth curve through the readings; the second
    derivatives by delays, `bends` (p,), have their roughness too, and are 0 for all else. `nis` is
    the mean of the innovations squared per degree of freedom, `freedoms` their number.
    """

    value: float
    gradient: np.ndarray
    information: np.ndarray
    bends: np.ndarray
    scatter: np.ndarray
    nis: float
    freedoms: int


def likelihood(
    log: LoggedReadings,
    tyre: Tyre,
    sought: tuple[Sought, ...],
    spreads: np.ndarray,
    widths: np.ndarray,
    car: Car | None = None,
) -> Likelihood:
    """The likelihood of a log for parameters so many spreads (p,) from those of `car`, or its own.

    Delays count as the whole samples next to them, which is exact: the readings move by so many.
    Differences by delays reach over `widths` (p,) samples (`widths_of`).
    """
    lanes = _Lanes.of(sought, log.time_step_s, widths)
    moved = spreads + lanes.moved
    filtered = LaneFilter(log, car_with(car or log.car, sought, moved), tyre, len(moved))
    totals = _Sums(lanes, round(CORRELATED_S / log.time_step_s))
    for innovation, cov in filtered.blocks():
        totals.add(innovation, cov)
    return totals.likelihood()


def widths_of(
    log: LoggedReadings, tyre: Tyre, sought: tuple[Sought, ...], spreads: np.ndarray
) -> np.ndarray:
    """Samples (p,) over which differences by delays show more than noise, 1 for all else, for
    parameters so many spreads (p,) from those of the log's car."""
    widths = np.ones(len(sought))
    lanes = _Lanes.of(sought, log.time_step_s, widths)
    ahead = lanes.moved[1 + len(sought) :][: len(lanes.delays)]
    each = [way * width * ahead for width in _WIDTHS for way in (1, -1)]
    moved = spreads + np.concatenate([lanes.moved[:1], *each])
    values = values_at(log, tyre, sought, moved)
    pairs = values[1:].reshape(len(_WIDTHS), 2, len(lanes.delays))
    enough = pairs.mean(axis=1) - values[0] > _RISE
    enough[-1] = True
    widths[lanes.delays] = np.array(_WIDTHS)[enough.argmax(axis=0)]
    return widths


def values_at(
    log: LoggedReadings, tyre: Tyre, sought: tuple[Sought, ...], spreads: np.ndarray
) -> np.ndarray:
    """The negative logarithm of the likelihood (lanes,) of cars so many spreads (lanes, p) away."""
    filtered = LaneFilter(log, car_with(log.car, sought, spreads), tyre, len(spreads))
    total = np.zeros(len(spreads))
    for innovation, cov in filtered.blocks():
        total += _terms(*_filled(innovation, cov))[0].sum(axis=0)
    return total


def squared(innovation: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """The normalised squares (...) of innovations (..., m); NaN entries were not taken."""
    return _terms(*_filled(innovation, cov))[1]


def _filled(innovation: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Innovations (..., m) and covariances with 0 and the identity for what was not taken."""
    missing = np.isnan(innovation)
    either = missing[..., :, None] | missing[..., None, :]
    return np.where(missing, 0.0, innovation), np.where(either, np.eye(missing.shape[-1]), cov)


def _terms(v: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Terms (...) of the negative logarithm of the likelihood, and squared innovations (...)."""
    squares = np.einsum("...i,...i->...", v, np.linalg.solve(s, v[..., None])[..., 0])
    return 0.5 * (np.linalg.slogdet(s)[1] + squares), squares


class _Lanes(NamedTuple):
    """Lanes of one batch: lane 0 has the parameters themselves, lane 1 + i parameter i moved by
    little. In the last lanes the readings of one sensor, of those with `delays` (q,), are some
    samples earlier, then later.

    `moved` is (1 + p + 2 q, p), in spreads; `reaches` (q,) are the lengths of so many samples.
    """

    moved: np.ndarray
    delays: np.ndarray
    reaches: np.ndarray

    @classmethod
    def of(cls, sought: tuple[Sought, ...], sample_s: float, widths: np.ndarray) -> "_Lanes":
        delays = np.flatnonzero([one.is_delay for one in sought])
        reaches = np.array([widths[one] * sample_s / sought[one].spread for one in delays])
        each = np.eye(len(sought))
        ahead = reaches[:, None] * each[delays]
        return cls(
            np.concatenate([0 * each[:1], DIFFERENCE * each, ahead, -ahead]), delays, reaches
        )

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """Derivatives (B, p, ...) of the values (B, 1 + p + 2 q, ...) of all lanes."""
        count = self.moved.shape[1]
        return (values[:, 1 : 1 + count] - values[:, :1]) / DIFFERENCE


class _Sums:
    """The sums over the innovations of a drive."""

    def __init__(self, lanes: _Lanes, correlated: int) -> None:
        count = lanes.moved.shape[1]
        self._lanes, self._correlated = lanes, correlated
        self._squares, self._freedoms = 0.0, 0
        self._information = np.zeros((count, count))
        self._scores: list[np.ndarray] = []
        self._values = np.zeros(len(lanes.moved))

    def add(self, innovation: np.ndarray, cov: np.ndarray) -> None:
        """Add innovations (B, lanes, m) with covariances (B, lanes, m, m), NaN for none."""
        v, s = _filled(innovation, cov)
        dv, ds = self._lanes.slopes(v), self._lanes.slopes(s)
        inverse = np.linalg.inv(s[:, 0])
        weighted = np.einsum("bij,bj->bi", inverse, v[:, 0])
        turned = np.einsum("bij,bpjk->bpik", inverse, ds)
        scores = 0.5 * np.einsum("bpii->bp", turned) + np.einsum("bi,bpi->bp", weighted, dv)
        scores -= 0.5 * np.einsum("bi,bpi->bp", weighted, np.einsum("bpij,bj->bpi", ds, weighted))
        self._information += 0.5 * np.tensordot(turned, turned.mT, ((0, 2, 3), (0, 2, 3)))
        of_dv = np.einsum("bij,bpj->bpi", inverse, dv)
        self._information += np.tensordot(dv, of_dv, ((0, 2), (0, 2)))
        values, squares = _terms(v, s)
        ahead, back = np.split(values[:, 1 + scores.shape[1] :], 2, axis=1)
        scores[:, self._lanes.delays] = (ahead - back) / (2 * self._lanes.reaches)
        self._scores.append(scores)
        self._values += values.sum(axis=0)
        self._squares += float(squares[:, 0].sum())
        self._freedoms += int(np.isfinite(innovation[:, 0]).sum())

    def likelihood(self) -> Likelihood:
        """The sums; derivatives by delays are differences of the likelihood itself."""
        lanes, count = self._lanes, self._lanes.moved.shape[1]
        scores = np.concatenate(self._scores)
        middle, (ahead, back) = self._values[0], np.split(self._values[1 + count :], 2)
        bends = np.zeros(count)
        bends[lanes.delays] = (ahead + back - 2 * middle) / lanes.reaches**2
        return Likelihood(
            float(middle),
            scores.sum(axis=0),
            self._information,
            bends,
            scatter_of(scores, self._correlated),
            self._squares / self._freedoms,
            self._freedoms,
        )
