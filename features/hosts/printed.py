"""The commands of a network on several hosts, for a shell, systemd, compose or Kubernetes."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import msgspec

from concord.features.hosts.plan import KEYS, SETUP, NetworkPlan, Process

_KUBERNETES = Path(__file__).with_name("kubernetes.yaml")
_IMAGE = "concord:0.1.0"


def shell(plan: NetworkPlan) -> str:
    """Return a script that runs the part of a host, in the folder with setup and keys."""
    parts = {}
    for host, entry in plan.hosts.items():

        def line(process: Process, program: str = entry.concord) -> str:
            return f"    {shlex.join([program, *process.words])} &"

        lines = [line(plan.router(host)), "    router=$!"]
        if entry.nodes:
            lines += [line(plan.node(host, *entry.nodes)), '    others="$others $!"']
        if host == plan.environment:
            # The last one: its exit code becomes that of the script.
            lines += [line(plan.environment_process(f"runs/{plan.run}")), '    others="$others $!"']
        parts[host] = lines
    begin = (
        "others=\ntrap 'kill $others $router 2>/dev/null || :; wait' EXIT\ntrap 'exit 130' INT TERM"
    )
    return _script(plan, begin, parts) + "wait $others\n"


def systemd(plan: NetworkPlan) -> str:
    """Return a script that installs and starts the units of a host; a root's shell runs it.

    Raises:
        ValueError: there are no keys, which the units need.
    """
    _need_keys(plan, "systemd")
    parts = {}
    for host, entry in plan.hosts.items():
        others = plan.routers_before(host)
        options = " ".join(["--connect", *others]) if others else ""
        units = ["concord-router", *(f"concord-node@{node}" for node in entry.nodes)]
        router, *own = (f"{KEYS}/{path.name}" for path in plan.keys[host])
        parts[host] = [
            f"    install -m 600 {router} $etc/keys/router.json",
            *([f"    install -m 600 {' '.join(own)} $etc/keys"] if own else []),
            "    cat > $etc/concord.env <<END",
            f"CONCORD_LISTEN={plan.endpoint(host)}",
            f"CONCORD_CONNECT={plan.endpoint(host)}",
            f"CONCORD_ROUTER_OPTIONS={options}",
            "END",
            "    systemctl daemon-reload",
            f"    systemctl enable --now {' '.join(units)}",
            *(["    systemctl start concord-environment"] if host == plan.environment else []),
        ]
    begin = (
        "# In the folder of deploy/, with setup.json and keys beside it. The program is in\n"
        "# /opt/concord (docs/deployment.md).\n"
        "etc=${DESTDIR:-}/etc/concord\nunits=${DESTDIR:-}/etc/systemd/system\n"
        f"install -d $etc $units\ninstall -d -m 700 $etc/keys\ninstall -m 644 {SETUP} $etc\n"
        "install -m 644 deploy/systemd/concord*.service deploy/systemd/concord.target $units"
    )
    return _script(plan, begin, parts)


def compose(plan: NetworkPlan) -> str:
    """Return a compose file: a service for each process, and a router for each host.

    Raises:
        ValueError: certificates for addresses, which compose does not give to services.
    """
    for host, entry in plan.hosts.items():
        if plan.has_keys and not re.search("[A-Za-z]", entry.address):
            raise ValueError(
                f"--print compose: the certificate of host {host} is for the address "
                f"{entry.address}, and services have names; use names in the hosts file"
            )
    if not plan.has_keys:
        hosts = {
            host: msgspec.structs.replace(entry, address=f"{host}-router")
            for host, entry in plan.hosts.items()
        }
        plan = msgspec.structs.replace(plan, hosts=hosts)
    lines = [
        f"# The network of run {plan.run} on one machine, for `docker compose up`; {SETUP}"
        + (f" and {KEYS}" if plan.has_keys else "") + " beside it.",
        "services:",
    ]  # fmt: skip
    for host, entry in plan.hosts.items():
        router = f"{host}-router"
        before = [f"{name}-router" for name in plan.hosts][: list(plan.hosts).index(host)]
        alias = entry.address if plan.has_keys else ""
        lines += _service(plan, router, plan.router(host), before, alias)
        if host == plan.environment:
            lines += _service(
                plan, f"{host}-environment", plan.environment_process(f"runs/{plan.run}"), [router]
            )
        for node in entry.nodes:
            lines += _service(plan, f"{host}-node-{node}", plan.node(host, node), [router])
    return "\n".join([*lines, "volumes:", "  runs: {}", ""])


def _service(
    plan: NetworkPlan, name: str, process: Process, after: list[str], address: str = ""
) -> list[str]:
    """Return the lines of a service; other services reach a router by its host's address."""
    words = ", ".join(f'"{word}"' for word in ("concord", *process.words))
    folder = "/var/lib/concord"
    lines = [
        f"  {name}:", f"    image: {_IMAGE}", f"    working_dir: {folder}",
        f"    command: [{words}]", "    stop_signal: SIGINT", "    volumes:",
        f"      - ./{SETUP}:{folder}/{SETUP}:ro",
    ]  # fmt: skip
    names = [path.name for path in plan.keys[process.host] if _uses(process, path.name)]
    lines += [f"      - ./{KEYS}/{name}:{folder}/{KEYS}/{name}:ro" for name in names]
    if process.words[0] == "environment":
        lines.append(f"      - runs:{folder}/runs")
    if process.words[0] == "node":
        lines.append("    restart: on-failure")
    if address:
        lines.append(f'    networks: {{default: {{aliases: ["{address}"]}}}}')
    return [*lines, *([f"    depends_on: [{', '.join(after)}]"] if after else [])]


def _uses(process: Process, key: str) -> bool:
    """Whether a process needs a file of its host's keys."""
    match process.words[0]:
        case "router":
            return key.startswith("router")
        case "environment":
            return key in ("environment.json", "recorder.json")
        case _:
            return key in {f"node-{number}.json" for number in process.name.split()[1:]}


def kubernetes(plan: NetworkPlan) -> str:
    """Return the manifest for the nodes of this network; the cluster places them.

    Raises:
        ValueError: there are no keys, which the manifest needs.
    """
    _need_keys(plan, "kubernetes")
    text = _KUBERNETES.read_text(encoding="utf-8")
    return re.sub(r"(completions|parallelism): \d+", rf"\1: {plan.nodes}", text)


FORMS: dict[str, Callable[[NetworkPlan], str]] = {
    "shell": shell,
    "systemd": systemd,
    "compose": compose,
    "kubernetes": kubernetes,
}


def _need_keys(plan: NetworkPlan, form: str) -> None:
    if not plan.has_keys:
        raise ValueError(
            f"--print {form}: its files expect keys, and the hosts file names none; make some with "
            '`concord keys` and add keys = "FOLDER"'
        )


def _script(plan: NetworkPlan, begin: str, parts: dict[str, list[str]]) -> str:
    """Return a script for the shell whose first word is the name of a host."""
    cases = [line for host, lines in parts.items() for line in (f"{host})", *lines, "    ;;")]
    usage = f'echo "usage: sh $0 {"|".join(parts)}" >&2; exit 2'
    return "\n".join([
        "#!/bin/sh", f"# Run {plan.run}: the part of one host, beside {SETUP}.", "set -eu",
        begin, "case ${1:-} in", *cases, f"*) {usage} ;;", "esac", "",
    ])  # fmt: skip
