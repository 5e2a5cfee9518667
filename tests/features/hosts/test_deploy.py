"""Test that tools accept the files of `deploy/`, and that their commands exist in concord."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from concord.experiments.__main__ import main
from concord.results.folder import read_description
from concord.runtime.network.links import free_ports
from tests.experiments.command_support import concord, refused
from tests.experiments.units import CONCORD, DEPLOY, UNITS, credentials, unit_command
from tests.features.hosts.hosts import hosts
from tests.features.hosts.test_hosts import write_setup
from tests.pages import ROOT, blocks
from tests.processes import PROC

SERVICES = ("concord-router.service", "concord-environment.service", "concord-node@.service")
# The first release in which an Indexed Job counts the failures of each pod by itself for good.
KUBERNETES = "1.33"
MOST_EXPOSED = 20

# Connections from one address, from another one, and from the first when one of its own has ended.
CONNECTIONS = """
import contextlib, socket

server = socket.create_server(("127.0.0.1", 7447), backlog=500)


def entered(address, count):
    sockets = []
    for _ in range(count):
        with contextlib.suppress(ConnectionError):
            sockets.append(socket.create_connection(("127.0.0.1", 7447), 10, (address, 0)))
    return sockets


one, other = entered("127.0.0.2", 70), entered("127.0.0.3", 1)
one[0].setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, bytes([1, 0, 0, 0, 0, 0, 0, 0]))
one[0].close()
print(len(one), len(other), len(entered("127.0.0.2", 1)))
"""


def _own_network() -> bool:
    """Return whether a test may have a network namespace with rules of its own."""
    if not all(shutil.which(program) for program in ("nft", "unshare", "ip")):
        return False
    tried = ["unshare", "-rn", "nft", "list", "ruleset"]
    return subprocess.run(tried, capture_output=True, check=False).returncode == 0


OWN_NETWORK = _own_network()
needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze comes with systemd"
)


def systemd_analyze(*words: object, units: Path) -> tuple[int, str]:
    """Exit code, and all that was said; units are looked up in that folder first."""
    done = subprocess.run(
        ["systemd-analyze", *map(str, words)],
        env={**os.environ, "SYSTEMD_UNIT_PATH": f"{units}:"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def installed(folder: Path) -> Path:
    """The units on a machine that has the program."""
    program = folder / "concord"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    for unit in UNITS.glob("concord*"):
        (folder / unit.name).write_text(unit.read_text().replace(CONCORD, str(program)))
    return folder


def instance(unit: str) -> str:
    return unit.replace("@.", "@3.")


@needs_systemd
@pytest.mark.parametrize("unit", [*SERVICES, "concord.target"])
def test_units_are_verified_by_systemd(unit: str, tmp_path: Path):
    units = installed(tmp_path)
    assert systemd_analyze("verify", units / instance(unit), units=units) == (0, "")
    broken = units / unit
    broken.write_text(broken.read_text().replace("[Unit]", "[Unit]\nAfterr=x"))
    _, said = systemd_analyze("verify", units / instance(unit), units=units)
    assert "Afterr" in said


@needs_systemd
@pytest.mark.parametrize("unit", SERVICES)
def test_units_may_do_little(unit: str, tmp_path: Path):
    """As systemd judges it: 0 is nothing at all, 100 everything."""
    here = tmp_path / instance(unit)
    here.write_bytes((UNITS / unit).read_bytes())
    threshold = f"--threshold={MOST_EXPOSED}"
    code, said = systemd_analyze("security", "--offline=yes", threshold, here, units=tmp_path)
    assert code == 0, said


@pytest.mark.skipif(not OWN_NETWORK, reason="needs nft, and a network namespace of one's own")
def test_one_address_has_so_many_connections_and_others_still_enter():
    """In a network namespace: the 64 of one address are taken, one more of it is refused."""
    rules = DEPLOY / "nftables" / "concord.nft"
    # Twice: as a service that is started again loads it.
    load = f"ip link set lo up && nft -f {rules} && nft -f {rules} && exec "
    words = shlex.join([sys.executable, "-c", CONNECTIONS])
    done = subprocess.run(
        ["unshare", "-rn", "sh", "-c", load + words],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.split() == ["64", "1", "1"], done.stderr


def test_units_start_in_order_and_come_back_where_that_helps():
    router, environment, node = ((UNITS / unit).read_text() for unit in SERVICES)
    assert "Restart=always" in router and "Restart=on-failure" in node
    # A second environment would be another run.
    assert "Restart=no" in environment
    assert "After=network-online.target concord-router.service\n" in environment
    assert (
        "After=network-online.target concord-router.service concord-environment.service\n" in node
    )


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there")
def test_the_commands_of_the_units_run_a_network_over_tls(tmp_path: Path):
    """Keys, setup, router, environment and two nodes, each with its own files alone, to the end."""
    pytest.importorskip("cryptography", reason="the extra secure makes certificates")
    keys = tmp_path / "keys"
    main(["keys", str(keys), "--nodes", "2"])
    setup = write_setup(tmp_path, nodes=2, graph="path", steps=60)
    port = free_ports(["router"])["router"]
    endpoint = f"tls/localhost:{port}"
    variables = {
        "CONCORD_LISTEN": endpoint,
        "CONCORD_CONNECT": endpoint,
        "CONCORD_ROUTER_OPTIONS": "",
    }

    def words(unit: str, instance: str = "") -> list[str]:
        folder = credentials(unit, keys, tmp_path / f"{unit}{instance}", instance)
        said = unit_command(unit, {**variables, "CREDENTIALS_DIRECTORY": str(folder)}, instance)
        return [word.replace("/etc/concord/setup.json", str(setup)) for word in said]

    with hosts(tmp_path) as there:
        router = there.concord(*words("concord-router.service"))
        router.await_line("router at")
        nodes = [there.concord(*words("concord-node@.service", number)) for number in "01"]
        environment = there.concord(
            *words("concord-environment.service"), "--out", tmp_path / "run", "--json"
        )
        code, out, err = environment.end(60)
        assert (code, out[:1]) == (0, "{"), err
        assert [node.end(10)[0] for node in nodes] == [0, 0]
    assert read_description(tmp_path / "run").run == "hosts"


# --- Kubernetes ----------------------------------------------------------------------------------


def manifest() -> list[dict[str, Any]]:
    yaml = pytest.importorskip("yaml", reason="reads manifests: pip install kubernetes-validate")
    return yaml.safe_load((DEPLOY / "kubernetes.yaml").read_text())["items"]


def pods() -> dict[str, dict[str, Any]]:
    """Return the pod specifications by the name of the deployment or job that makes them."""
    return {
        one["metadata"]["name"]: one["spec"]["template"]["spec"]
        for one in manifest()
        if one["kind"] in ("Deployment", "Job")
    }


def test_the_manifest_is_valid_by_the_schemas_of_kubernetes():
    validator = pytest.importorskip(
        "kubernetes_validate", reason="pip install kubernetes-validate, or make"
    )
    for one in manifest():
        validator.validate(one, KUBERNETES, strict=True)
    wrong = next(one for one in manifest() if one["kind"] == "Job")
    wrong["spec"]["completion"] = 3
    with pytest.raises(validator.ValidationError):
        validator.validate(wrong, KUBERNETES, strict=True)


def test_what_pods_want_is_there(tmp_path: Path):
    """Volumes, keys of `concord keys`, labels and numbers fit together."""
    pytest.importorskip("cryptography", reason="the extra secure makes certificates")
    main(["keys", str(tmp_path / "keys"), "--nodes", "6", "--hosts", "concord-router"])
    made = {file.name for file in (tmp_path / "keys").iterdir()}
    for pod in pods().values():
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        for container in [*pod["containers"], *pod.get("initContainers", ())]:
            mounts = {mount["name"] for mount in container.get("volumeMounts", ())}
            assert mounts <= {*volumes}
            assert container["securityContext"]["readOnlyRootFilesystem"]
        wanted = {item["key"] for item in volumes["keys"]["secret"].get("items", ())}
        assert wanted <= made
        assert not pod["automountServiceAccountToken"] and pod["securityContext"]["runAsNonRoot"]
    by_kind = {(one["kind"], one["metadata"]["name"]): one for one in manifest()}
    nodes = by_kind["Job", "concord-nodes"]["spec"]
    assert nodes["completions"] == nodes["parallelism"] and nodes["completionMode"] == "Indexed"
    router = by_kind["Deployment", "concord-router"]["spec"]["template"]["metadata"]["labels"]
    assert by_kind["Service", "concord-router"]["spec"]["selector"] == router
    # Each node sees its own key, and no process sees the authority's.
    [node] = pods()["concord-nodes"]["containers"]
    assert {"name": "own-key", "mountPath": "/keys", "readOnly": True} in node["volumeMounts"]
    assert "keys" not in {mount["name"] for mount in node["volumeMounts"]}


@pytest.mark.parametrize("pod", ["concord-router", "concord-environment", "concord-nodes"])
def test_pods_start_commands_of_ours(pod: str, capsys: pytest.CaptureFixture[str]):
    """Read to the end by the command line, which then misses the files of another machine."""
    [container] = pods()[pod]["containers"]
    program, *words = container["command"]
    assert program == "concord"
    with pytest.raises(SystemExit) as end:
        main([word.replace("$(JOB_COMPLETION_INDEX)", "3") for word in words])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert "cannot be read" in said or "no such file" in said


def test_the_compose_file_of_the_page_starts_commands_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    yaml = pytest.importorskip("yaml", reason="comes with kubernetes-validate")
    page = (ROOT / "docs" / "deployment.md").read_text(encoding="utf-8")
    (block,) = blocks(page, "yaml")
    services = yaml.safe_load(block)["services"]
    assert set(services) == {"router", "environment", "node-0", "node-1", "node-2"}
    assert services.pop("router")["command"][:3] == ["concord", "router", "--listen"]
    # There is no setup here: each command is read to the end before it misses the file.
    monkeypatch.chdir(tmp_path)
    for name, service in services.items():
        assert service["depends_on"] == ["router"]
        program, *words = service["command"]
        assert program == "concord" and "tcp/router:7447" in words
        assert "cannot be read" in refused(concord(capsys, *words)), name
