"""The errata of Meng et al. (2025), numbered as docs/papers/meng2025.md explains them."""

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.meng2025 import paper_points
from concord.papers.kit.claims import Erratum
from concord.papers.meng2025.runs import SlotEstimates
from concord.papers.meng2025.table import EstimatorRow

_PRINTED = (
    ("(19)", "P_yy with noise on the fresh rows alone", "singular beyond 2n + 1 entries"),
    ("(17), (18)", "held rows predicted for another instant", "the held value is known: use it"),
    ("(19)", "held values without noise", "the noise that is in a held value"),
    ("(20)", "points without process noise paired with points with it", "redraw the points"),
    ("(15)", "ybar and the predictions of step 0", "undefined; here those of the prior"),
    ("(13), (19)", "E(g g') and E(b b')", "Pi (x' Gamma x + tr(Gamma P))"),
    ("(2)", "q; R_1 as a set of two", "q = ceil(s / l1)"),
    ("(3)", "Phi for scalar sensors", "blocks for sensors that measure vectors"),
    ("(4)", "weights; ties", "not given; here the identity, and the lowest node"),
    ("(1)", "the time of f and h", "f: of the state it moves; h: of the state it sees"),
    ("Remark 1", "smaller alpha and gamma decrease the complexity", "the points are as many"),
    ("section 4", "the index of the MSE", "undefined; here the mean over runs at each step"),
    ("Figure 4", "an upper bound of the MSE", "derived nowhere; the nearest is tr P"),
    ("section 4", "the initial state", "not given; here drawn from the prior"),
    ("(10)", "the root of P", "rows or columns is not said; here columns of the Cholesky factor"),
    ("section 4", "data transmission is effectively reduced", "by construction"),
)


def errata(recommended: SlotEstimates, rows: dict[str, EstimatorRow]) -> list[Erratum]:
    """The list, with figures where a figure belongs to an erratum."""
    ours, every = rows["recommended"].mse.value, rows["all"].mse.value
    points = " and ".join(str(len(paper_points(alpha).unit_points)) for alpha in (1.0, 0.1))
    added = {
        7: f"; then the slots are {order_of_slots(recommended, 10)}",
        11: f": {points} for alpha 1 and 0.1; alpha = 0 is admitted and divides by zero",
        16: f": {100 * recommended.sent.mean():.1f} % of the measurements are sent; with all of "
        f"them the mean square error is smaller by a factor of {ours / every:.1f}",
    }
    return [
        Erratum(number, where, printed, correct + added.get(number, ""))
        for number, (where, printed, correct) in enumerate(_PRINTED, start=1)
    ]


def order_of_slots(outcome: SlotEstimates, slots: int) -> str:
    """Senders of the first slots, the same in every run; d where runs contended."""
    names = []
    for sent in outcome.sent[:slots]:
        sensors = {int(sensor) + 1 for sensor in sent.argmax(axis=-1)}
        contended = min(sensors) > meng2025.STATIC_SLOTS
        names.append("d" if contended else ",".join(map(str, sorted(sensors))))
    return " ".join(names)
