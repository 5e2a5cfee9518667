import resource
import sys

import numpy as np
import pytest

from concord.studies.monte_carlo.simulate import keep_freed_memory


def faults_of_temporaries() -> int:
    """Page faults of a hundred arrays of 4 MB, one after the other."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(100):
        np.ones(500_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(sys.platform != "linux", reason="the C library is another one")
def test_arrays_that_come_and_go_are_not_mapped_anew():
    if not keep_freed_memory():
        pytest.skip("the C library cannot be told")
    faults_of_temporaries()
    assert faults_of_temporaries() < 100
