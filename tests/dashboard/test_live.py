"""A page on a network that is not there."""

import time

import pytest

from dashboard.live import LiveNetwork

pytestmark = pytest.mark.zenoh


def test_nobody_at_an_endpoint_is_said_in_one_sentence():
    started = time.monotonic()
    with pytest.raises(ValueError, match="no network answers"):
        LiveNetwork(["tcp/127.0.0.1:9"], "nobody")
    assert time.monotonic() - started < 15
