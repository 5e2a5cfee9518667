"""Reproductions use all cores: their results do not depend on how many processes compute them."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from concord.papers.adlukf import drives
from concord.papers.kit import side_by_side as module
from concord.papers.kit.side_by_side import side_by_side
from concord.papers.liu2021 import reproduce as liu2021
from concord.papers.liu2021.runs import ESTIMATORS
from concord.papers.liu2021.runs import simulate as sequences
from concord.papers.meng2025 import reproduce as meng2025
from concord.papers.meng2025.runs import simulate as measured
from concord.papers.wac import exact


def arrays(value: Any) -> list[np.ndarray]:
    """Return all arrays in a result, in order."""
    if isinstance(value, dict):
        return [array for one in value.values() for array in arrays(one)]
    if isinstance(value, tuple | list):
        return [array for one in value for array in arrays(one)]
    return [] if value is None or isinstance(value, str) else [np.asarray(value)]


def of_liu2021() -> Any:
    names = list(ESTIMATORS)[:2]
    return side_by_side("", partial(liu2021._estimates, sequences(1, 3, 10)), names)


def of_meng2025() -> Any:
    return side_by_side("", partial(meng2025._carry_out, measured(1, 3, 10)), ["alpha", "rrp"])


def of_adlukf() -> Any:
    return drives.drive_elsewhere(1, 5)


def of_wac() -> Any:
    return exact.measure({name: exact.PLANTS[name] for name in ("cruise", "speed")})


@pytest.mark.slow
@pytest.mark.parametrize("work", [of_liu2021, of_meng2025, of_adlukf, of_wac])
def test_results_do_not_depend_on_the_number_of_processes(
    work: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
):
    if work is of_adlukf:
        pytest.importorskip("vehiclemodels", reason="the extra vehicle simulates the car")
        monkeypatch.setattr(drives, "ELSEWHERE", drives.ELSEWHERE[:2])
    if work is of_wac:
        monkeypatch.setattr(exact, "STEPS", 10)
    found = []
    for workers in (1, 2):
        monkeypatch.setattr(module, "workers_here", lambda _, workers=workers: workers)
        found.append(arrays(work()))
    assert found[0] and len(found[0]) == len(found[1])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_jobs_use_all_cores_unasked_and_keep_their_order(monkeypatch: pytest.MonkeyPatch):
    asked = []

    def backwards(workers: int, work: Callable, jobs: list) -> Any:
        asked.append(workers)
        return ((place, work(jobs[place])) for place in reversed(range(len(jobs))))

    monkeypatch.setattr(module, "in_processes", backwards)
    assert side_by_side("", abs, [-3, 2, -1]) == [3, 2, 1]
    assert asked == [module.workers_here(None)]
