"""docs/control.md: its commands to a network that runs are taken, one after the other."""

import signal
from pathlib import Path

import pytest

from tests.pages import ROOT, blocks, link_checkout, run_as_reader
from tests.processes import CONCORD, PROC, family, holds_within

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "control.md").read_text(encoding="utf-8")
FIRST, *WORDS = [line.partition(" #")[0].split() for line in blocks(PAGE, "")[0].splitlines()]


@pytest.mark.zenoh
@pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there")
def test_a_network_takes_the_commands_of_the_page(tmp_path: Path):
    checkout = link_checkout(tmp_path)
    assert len(WORDS) >= 6
    with family([*CONCORD, *FIRST[1:]], checkout) as network:
        assert holds_within(20, (checkout / "runs" / "mine" / "network.json").exists)
        for command in WORDS:
            run_as_reader(" ".join(command), checkout)
        network.send(signal.SIGINT)
        assert network.gone_within(10)
