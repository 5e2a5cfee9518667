"""Shared settings of all tests: one BLAS thread, the hypothesis profile, the real data folder."""

import gc
import os

# This runs before numpy is imported: results must not depend on how many threads share a sum.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.dashboard.conftest import HOW
from tests.house.sources import packages

ROOT = Path(__file__).resolve().parent.parent

# A busy machine is no failure; a build server tries the same examples every time.
settings.register_profile("concord", deadline=None, print_blob=True)
settings.register_profile("ci", settings.get_profile("concord"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "concord")


LONGEST = (
    "test_readme", "experiments/test_verdict_levels", "test_own_page",
    "features/vehicle/test_vehicle_page", "experiments/test_audit", "experiments/test_compare",
    "experiments/test_plots", "nodes/test_broken_links", "test_examples", "test_sweep_pages",
    "experiments/test_clusters", "features/vehicle/identification/test_fit",
    "experiments/test_realtime_losses", "experiments/test_interruption", "studies/test_exact_page",
    "dashboard/test_monkey", "dashboard/test_browser_live", "runtime/test_new_links",
    "features/vehicle/test_scenario", "test_batched_agreement", "experiments/test_churned_runs",
    "test_readers", "test_labelled_arrays", "dashboard/test_browser_launch",
)  # fmt: skip
"""Files that take a worker most of a minute. A file that starts last lets the others wait."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that look at a page in a browser; put the files that take longest first."""
    sizes = Counter(item.path for item in items)
    places = {ROOT / "tests" / f"{name}.py": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (places.get(item.path, len(places)), -sizes[item.path]))
    for item in items:
        if "chromium" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.browser)
    # The collected tests live to the end: searches for garbage need not walk through them.
    gc.collect()
    gc.freeze()


def pytest_unconfigure(config: pytest.Config) -> None:
    """End the output with a line where tests of the page were skipped for lack of a browser."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    reports = [] if reporter is None else reporter.stats.get("skipped", [])
    without = sum(HOW in str(report.longrepr) for report in reports)
    if reporter is not None and without:
        reporter.write_line(f"NO BROWSER: {without} tests of the page were skipped; it {HOW}")


@pytest.fixture(autouse=True, scope="session")
def _own_list(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the list of own code (`scenarios/user/trust.py`) apart from that of the developer."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="module")
def _trees_are_dropped() -> Iterator[None]:
    """Later tests of this process would carry a million syntax nodes through each collection."""
    yield
    packages.cache_clear()


@pytest.fixture(autouse=True)
def _same_priority() -> Iterator[None]:
    """Fail a test that lowers the priority of the process that runs all tests."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    yield
    assert os.getpriority(os.PRIO_PROCESS, 0) == before, "this test has reniced the test process"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded data beside the checkout."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("needs recorded data in ../shared/data, which is no part of the checkout")
    return folder


@pytest.fixture(scope="session")
def mrclam_folder(shared_data: Path) -> Path:
    """UTIAS MRCLAM, data set 6."""
    folder = shared_data / "mrclam6"
    if not folder.is_dir():
        pytest.skip("needs UTIAS MRCLAM data set 6 in ../shared/data/mrclam6")
    return folder
