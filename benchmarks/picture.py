"""What `make bench` measured as a picture, for the page on performance."""

from pathlib import Path

from benchmarks.measure import Figures

COLOURS = {"A": "#2a6f97", "B": "#e07a1f"}
ORDER = (
    "Stone Soup",
    "filterpy",
    "numpy, one",
    "compiled, one",
    "numpy, many",
    "C loop",
    "compiled, many",
)
LABELS = {
    "numpy, one": "concord, one filter",
    "compiled, one": "concord + kernels, one filter",
    "C loop": "loop in C, models in C",
    "numpy, many": "concord, 10,000 filters",
    "compiled, many": "concord + kernels, 10,000 filters",
}


def draw(ukf: Figures, path: Path) -> None:
    """Steps per second of the UKF, both cases, on a logarithmic scale."""
    import matplotlib.pyplot as plt

    names = [name for name in ORDER if f"A {name} us" in ukf]
    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    for place, case in enumerate(COLOURS):
        for row, name in enumerate(names):
            spent = ukf[f"{case} {name} us"]
            rate = 1e6 / spent.value
            height = row + 0.2 - 0.4 * place
            axes.barh(height, rate, 0.36, color=COLOURS[case], label=None if row else _title(case))
            beside = ukf[f"{case} {name} x filterpy"].value
            text = f"{beside:,.0f} x" if beside >= 10 else f"{beside:.1f} x"
            axes.annotate(text, (rate, height), (4, 0), textcoords="offset points", va="center")
    axes.set_xscale("log")
    axes.set_xlim(300, 1e8)
    axes.set_yticks(range(len(names)), [LABELS.get(name, name) for name in names])
    axes.set_xlabel("filter steps per second on one core (numbers: times filterpy)")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _title(case: str) -> str:
    return {"A": "straight line, n = 4", "B": "turn by range and bearing, n = 5"}[case]
