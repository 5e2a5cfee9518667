"""The compiled kernels, built for this machine, pass the tests that numpy passes.

The suite itself uses the installed kernels; a new machine has numpy alone. This test builds the
kernels into a temporary folder. With these kernels required, it runs two groups of tests again:
those that compare the kernels with numpy, and those that compare the drivers with each other.
"""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DEMANDED = (
    "tests/filters/test_compiled.py",
    "tests/filters/test_fusion.py",
    "tests/test_agreement.py",
    "tests/test_batched_agreement.py",
)

pytestmark = pytest.mark.skipif(
    shutil.which("c++") is None,
    reason="no C++ compiler (c++): install g++ or clang to test kernels",
)


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder from which `concord_fast` can be imported; the source stays as it is."""
    folder = tmp_path_factory.mktemp("kernels")
    source = shutil.copytree(ROOT / "fast", folder / "source")
    build = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    offline = ["--no-index", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, *offline, "--target", folder / "built", source], check=True)
    return folder / "built"


def test_compiled_kernels_pass_what_numpy_passes(kernels: Path):
    demanded = os.environ | {"CONCORD_KERNELS": "compiled", "PYTHONPATH": str(kernels)}
    again = [sys.executable, "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", *DEMANDED]
    run = subprocess.run(
        [*again, "-m", "not slow"], cwd=ROOT, env=demanded, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout
    assert "no compiled kernels" not in run.stdout


def test_the_extra_demands_the_kernels_that_are_built():
    extras, package = (
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
        for folder in (".", "fast")
    )
    wanted = f"{package['name']}=={package['version']}"
    assert extras["optional-dependencies"]["fast"] == [wanted]
