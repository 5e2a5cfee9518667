"""The verdict on a run in words: its error beside the best and beside none, and its consistency."""

import numpy as np

from concord.results.figures.intervals import Interval, positive_mean_t

BATCHES = 10
MARGIN = 1.1
"""Least ratio of ANEES to 1, or of 1 to it, that is called over- or underconfident."""
# Beyond this ratio the error of the filter that hears everything is rounding.
_EXACT = 1e6
LEGEND = (
    "RMSE         error of the node in the network",
    "alone        its error without neighbours",
    "ANEES        squared error over its covariance: 1 is right, more overconfident",
    "NIS          the same of innovations, which are readings minus their predictions",
    "sent, heard  frames; missed: frames that were due and did not come",
    "rejected     frames that the node could not use",
    "centralised  one filter that hears every sensor",
)


def anees_interval(consistency: np.ndarray, confidence: float = 0.95) -> Interval:
    """The interval of a mean over steps (S,) that depend on each other.

    It is that of the means of `BATCHES` batches of consecutive steps (batch means, Law 2015,
    section 9.5.3); NaN for fewer than two steps a batch.
    """
    known = consistency[~np.isnan(consistency)]
    if len(known) < 2 * BATCHES:
        return Interval(float(known.mean()) if len(known) else np.nan, np.nan, np.nan)
    means = np.array([batch.mean() for batch in np.array_split(known, BATCHES)])
    return positive_mean_t(means, confidence)


def consistency_in_words(anees: Interval) -> str:
    """Whether estimates claim what they know: "overconfident (ANEES 2.1, 95 %: 1.4 to 3)"."""
    value, low, high = anees
    if np.isnan(value):
        return "of unknown consistency"
    if np.isnan(low):
        return f"too few scored steps to judge its consistency (ANEES {value:.3g})"
    shown = f"(ANEES {value:.3g}, 95 %: {low:.2g} to {high:.2g})"
    return f"{beyond(anees) or 'neither over- nor underconfident'} {shown}"


def beyond(found: Interval) -> str:
    """ "overconfident" or "underconfident" of a figure that is 1 where estimates claim what they
    know; empty where its interval holds 1, or where it departs by less than `MARGIN`."""
    if found.low > 1 and found.value > MARGIN:
        return "overconfident"
    if found.high < 1 and found.value < 1 / MARGIN:
        return "underconfident"
    return ""


def worst_in_words(ratio: float) -> str:
    """The worst node beside the filter that hears everything; empty without a truth."""
    if np.isnan(ratio):
        return ""
    if ratio > _EXACT:
        return "worst node beside exact knowledge; "
    return f"worst node {ratio:.2f} x centralised; "


def verdict(rmse: float, centralised: float, alone: float, anees: Interval) -> str:
    """The sentence that opens the figures of runs with Gaussian estimates."""
    if np.isnan(rmse) or np.isnan(centralised):
        return "network: the truth is not known; NIS tells how well the readings fit the estimates"
    gain = alone / rmse
    beside = f"{gain:.3g} x better than alone" if gain >= 1.05 else f"{1 / gain:.3g} x that alone"
    return (
        f"network: {rmse / centralised:.3g} x the error of the filter that hears everything, "
        f"{beside}, {consistency_in_words(anees)}"
    )
