"""`concord check` of scenarios: a correct one holds every promise, and each mistake is found."""

import shlex
from pathlib import Path

import pytest

from concord.experiments.cli.command_line import main
from concord.studies.check.scenario_promises import SCENARIO_PROMISES
from tests.experiments.test_check_rules import checked

WRONG = f"{Path(__file__).parent}/wrong_scenarios.py"
PROMISES = [promise.name for promise in SCENARIO_PROMISES]


@pytest.mark.zenoh
def test_a_correct_scenario_keeps_every_promise(capsys: pytest.CaptureFixture[str]):
    for name in (f"{WRONG}:CORRECT", "dc-motor-speed"):
        code, rows = checked(capsys, name, "--cases", "30")
        assert code == 0 and [*rows] == PROMISES
        assert {row["status"] for row in rows.values()} == {"holds"}


@pytest.mark.zenoh
@pytest.mark.parametrize("promise", PROMISES)
def test_a_planted_mistake_is_found(promise: str, capsys: pytest.CaptureFixture[str]):
    asked = (f"{WRONG}:{promise.upper()}", "--promise", promise, "--cases", "20")
    code, rows = checked(capsys, *asked)
    # Some plants cannot be observed, and their filters are right nevertheless.
    wanted = (0, "note") if promise == "observable" else (1, "BROKEN")
    assert (code, rows[promise]["status"]) == wanted, rows[promise]["seen"]
    again = shlex.split(rows[promise]["again"])
    with pytest.raises(SystemExit) as ended:
        main(again[1:])
    assert ended.value.code == code
    assert promise == "agreement" or rows[promise]["seen"] in capsys.readouterr().out


def test_a_fixed_number_of_nodes_skips_their_draws(capsys: pytest.CaptureFixture[str]):
    _, rows = checked(capsys, "vehicle-network", "--promise", "draws")
    assert rows["draws"]["status"] == "skipped" and "--nodes 5" in rows["draws"]["seen"]


def test_a_measurement_bus_is_refused(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(["check", "meng2025"])
    assert ended.value.code == 2 and "measurement bus" in capsys.readouterr().err
