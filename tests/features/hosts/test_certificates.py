"""Test the keys of a network: content of the files, their permissions, and refusals."""

import base64
import ipaddress
import shutil
import stat
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import pytest

from concord.features.hosts.access_control import access_control, rights
from concord.features.hosts.certificates import (
    AUTHORITY,
    AUTHORITY_KEY,
    faults_of_keys,
    make_keys,
)

x509 = pytest.importorskip("cryptography.x509")
HOSTS = ("sensors.example.org", "192.0.2.7")


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys") / "new"
    make_keys(folder, 3, HOSTS, 30)
    return folder


def certificate(file: Path):
    tls = msgspec.json.decode(file.read_bytes())["transport"]["link"]["tls"]
    return x509.load_pem_x509_certificate(base64.b64decode(tls["connect_certificate_base64"]))


def test_there_is_one_file_per_process_and_only_its_owner_reads_it(keys: Path):
    names = {file.name for file in keys.iterdir()}
    routers = {f"router-{host}.json" for host in HOSTS}
    members = {f"{name}.json" for name in rights(3)}
    assert names == {AUTHORITY, AUTHORITY_KEY} | routers | members
    modes = {file.name: stat.S_IMODE(file.stat().st_mode) for file in keys.iterdir()}
    assert modes.pop(AUTHORITY) & 0o022 == 0
    assert set(modes.values()) == {0o600}
    assert stat.S_IMODE(keys.stat().st_mode) == 0o700


def test_every_certificate_is_the_authority_s_and_says_one_name(keys: Path):
    authority = x509.load_pem_x509_certificate((keys / AUTHORITY).read_bytes())
    for file in keys.glob("*.json"):
        one = certificate(file)
        one.verify_directly_issued_by(authority)
        (name,) = one.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
        assert name.value == file.stem
        assert not one.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        left = one.not_valid_after_utc - datetime.now(UTC)
        assert timedelta(days=29) < left <= timedelta(days=30)


def test_routers_answer_at_their_hosts_alone(keys: Path):
    for host in HOSTS:
        extension = certificate(keys / f"router-{host}.json").extensions
        names = extension.get_extension_for_class(x509.SubjectAlternativeName).value
        places = names.get_values_for_type(x509.DNSName)
        places += map(str, names.get_values_for_type(x509.IPAddress))
        assert set(places) == {host, "localhost", "127.0.0.1"}


def test_private_keys_are_in_one_file_each(keys: Path):
    def key(file: Path) -> str:
        tls = msgspec.json.decode(file.read_bytes())["transport"]["link"]["tls"]
        return tls["connect_private_key_base64"]

    files = list(keys.glob("*.json"))
    assert len({key(file) for file in files}) == len(files)


def test_existing_keys_are_never_overwritten(keys: Path):
    before = {file: file.read_bytes() for file in keys.iterdir()}
    with pytest.raises(ValueError, match="never overwritten"):
        make_keys(keys, 3, (), 30)
    assert {file: file.read_bytes() for file in keys.iterdir()} == before


@pytest.mark.parametrize(
    ("nodes", "hosts", "days", "says"),
    [
        (0, (), 30, "--nodes 0"),
        (5000, (), 30, "1 to 4096"),
        (2, (), 0, "--days 0"),
        (2, (), 100_000, "--days"),
        (2, ("../etc",), 30, "neither a host name"),
        (2, ("a b",), 30, "neither a host name"),
        (2, ("",), 30, "neither a host name"),
        (2, ("a\n",), 30, "neither a host name"),
        (2, ("-a",), 30, "neither a host name"),
        (2, ("a", "a"), 30, "named twice"),
    ],
)
def test_bad_wishes_leave_nothing_behind(tmp_path: Path, nodes, hosts, days, says):
    with pytest.raises(ValueError, match=says):
        make_keys(tmp_path / "keys", nodes, hosts, days)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("address", ["::1", "10.0.0.1"])
def test_addresses_are_hosts(tmp_path: Path, address: str):
    make_keys(tmp_path / "keys", 1, (address,), 1)
    extension = certificate(tmp_path / "keys" / f"router-{address}.json").extensions
    names = extension.get_extension_for_class(x509.SubjectAlternativeName).value
    assert ipaddress.ip_address(address) in names.get_values_for_type(x509.IPAddress)


def test_sound_keys_have_no_fault_until_they_expire(keys: Path):
    faults = faults_of_keys(keys, datetime.now(UTC))
    assert set(faults) == {file.name for file in keys.glob("*.json")} and not any(faults.values())
    later = faults_of_keys(keys, datetime.now(UTC) + timedelta(days=31))
    assert all("not now: make new keys" in fault for fault in later.values())


def test_keys_that_are_not_sound_are_told_with_the_reason(keys: Path, tmp_path: Path):
    here, other = tmp_path / "here", tmp_path / "other"
    make_keys(other, 1, (), 1)
    shutil.copytree(keys, here)

    def told(name: str) -> str:
        return faults_of_keys(here, datetime.now(UTC))[name]

    def spoil(name: str, change: Callable[[dict], None]) -> None:
        config = msgspec.json.decode((here / name).read_bytes())
        change(config)
        (here / name).write_bytes(msgspec.json.encode(config))

    def tls(config: dict) -> dict:
        return config["transport"]["link"]["tls"]

    strange = tls(msgspec.json.decode((other / "node-0.json").read_bytes()))
    own = tls(msgspec.json.decode((here / "node-1.json").read_bytes()))
    key, authority = "connect_private_key_base64", "root_ca_certificate_base64"
    spoil("node-0.json", lambda config: tls(config).update({authority: strange[authority]}))
    assert "of another authority" in told("node-0.json")
    spoil("monitor.json", lambda config: tls(config).update({key: own[key]}))
    assert "its key belongs to another certificate" in told("monitor.json")
    spoil("operator.json", lambda config: tls(config).update(own))
    assert "its certificate is of CN=node-1" in told("operator.json")
    router = next(here.glob("router*.json")).name
    spoil(router, lambda config: config["access_control"].update(enabled=False))
    assert "access control is off" in told(router)
    (here / "recorder.json").chmod(0o644)
    assert "chmod 600" in told("recorder.json")
    (here / "environment.json").write_text("{")
    assert "not sound" in told("environment.json")
    shutil.copy(other / "node-0.json", here / "node-0.json")
    assert "trusts another authority" in told("node-0.json")


def test_a_folder_without_keys_is_a_sentence(tmp_path: Path):
    with pytest.raises(ValueError, match="no keys there"):
        faults_of_keys(tmp_path, datetime.now(UTC))


def test_what_may_be_published_belongs_to_one_process():
    """Each topic of a node or the environment has one publisher; a monitor publishes nothing."""
    table = rights(12)
    said = [topic for name, one in table.items() if name != "recorder" for topic in one.says]
    assert len(said) == len(set(said))
    for node in range(12):
        assert all(topic.endswith(f"/{node}") for topic in table[f"node-{node}"].says)
        assert table[f"node-{node}"].is_ready == (f"ready/{node}",)
    assert not table["monitor"].says and not table["monitor"].is_ready
    assert "control" not in table["monitor"].asks
    assert not table["operator"].says and "control" in table["operator"].asks


def test_whatever_is_not_allowed_is_denied():
    control = access_control(2, ("router-a", "router-b"))
    assert control["default_permission"] == "deny" and control["enabled"]
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    # Only routers, whose clients have been checked already, bring in anything at all.
    wide = {r["id"] for r in control["rules"] if "ingress" in r["flows"] and "put" in r["messages"]}
    wide &= {r["id"] for r in control["rules"] if "concord/*/**" in r["key_exprs"]}
    holders = [p["subjects"] for p in control["policies"] if wide & set(p["rules"])]
    assert holders == [["routers"]]
    names = {rule["id"] for rule in control["rules"]}
    assert all(set(policy["rules"]) <= names for policy in control["policies"])
