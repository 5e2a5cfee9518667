"""A certificate authority of one's own, and the zenoh configuration of every process as one file.

Each file carries what its process needs and nothing else: its certificate, its private key and the
authority's certificate. It can be copied to its host as it is, and there is nothing to point at.
"""

import base64
import ipaddress
import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from concord.features.hosts.access_control import ROUTER_NAME, access_control, rights, size_limits
from concord.runtime.network.links import check_private

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

MAX_NODES = 4096
MAX_DAYS = 3650
AUTHORITY, AUTHORITY_KEY = "authority.pem", "authority-key.pem"
_LOCAL = ("localhost", "127.0.0.1")
_HOST = re.compile(
    r"(?=.{1,253}\Z)[A-Za-z0-9]([A-Za-z0-9-]{0,62})(\.[A-Za-z0-9][A-Za-z0-9-]{0,62})*"
)
# Clocks of hosts differ by minutes at times.
_CLOCK_SLACK = timedelta(hours=1)


class Authority(NamedTuple):
    """Certificate authority: a certificate and its private key."""

    certificate: "x509.Certificate"
    key: "ec.EllipticCurvePrivateKey"


def require_library() -> None:
    """Raises:
    ValueError: the library that makes certificates is not installed.
    """
    try:
        import cryptography  # noqa: F401
    except ImportError:
        raise ValueError(
            "certificates need the package cryptography, which is not installed: run "
            "`make extras`, or `pip install '.[secure]'` in a checkout of concord"
        ) from None


def checked_hosts(hosts: Sequence[str]) -> tuple[str, ...]:
    """The hosts, each a DNS name or an IP address, once.

    Raises:
        ValueError: one is neither, or is named twice.
    """
    for host in hosts:
        if not _HOST.fullmatch(host) and not _is_address(host):
            raise ValueError(
                f"--hosts {host!r}: neither a host name (letters, digits, '-' and '.') nor an IP "
                "address; name the hosts that run a router as others reach them"
            )
    if len(set(hosts)) < len(hosts):
        raise ValueError(f"--hosts {' '.join(hosts)}: a host is named twice; name each once")
    return tuple(hosts)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def new_authority(days: int) -> Authority:
    """A new certificate authority, valid for `days` from now."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = _name("concord authority")
    signs = x509.KeyUsage(False, False, False, False, False, True, True, False, False)
    certificate = (
        _builder(key.public_key(), name, timedelta(days=days))
        .issuer_name(name)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(signs, critical=True)
        .sign(key, hashes.SHA256())
    )
    return Authority(certificate, key)


def issue(
    authority: Authority, name: str, hosts: Sequence[str], valid: timedelta
) -> tuple[bytes, bytes]:
    """A certificate for `name`, answering at `hosts`: (certificate, private key) as PEM.

    `valid` counts from now; where it is negative the certificate has expired.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = ec.generate_private_key(ec.SECP256R1())
    places = [
        x509.IPAddress(ipaddress.ip_address(host)) if _is_address(host) else x509.DNSName(host)
        for host in hosts
    ]
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    certificate = (
        _builder(key.public_key(), _name(name), valid)
        .issuer_name(authority.certificate.subject)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usage), critical=False)
        .add_extension(x509.SubjectAlternativeName(places), critical=False)
        .sign(authority.key, hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM), _key_pem(key)


def _name(common_name: str) -> "x509.Name":
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(
    key: "ec.EllipticCurvePublicKey", subject: "x509.Name", valid: timedelta
) -> "x509.CertificateBuilder":
    from cryptography import x509

    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(now, now + valid) - _CLOCK_SLACK)
        .not_valid_after(now + valid)
    )


def _key_pem(key: "ec.EllipticCurvePrivateKey") -> bytes:
    from cryptography.hazmat.primitives import serialization

    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _authority_pem(authority: Authority) -> bytes:
    from cryptography.hazmat.primitives import serialization

    return authority.certificate.public_bytes(serialization.Encoding.PEM)


def zenoh_settings(authority: Authority, certificate: bytes, key: bytes) -> dict[str, Any]:
    """The part of a zenoh configuration for mutual proof of identity."""
    encoded = {
        "root_ca_certificate_base64": _authority_pem(authority),
        "connect_certificate_base64": certificate,
        "connect_private_key_base64": key,
        "listen_certificate_base64": certificate,
        "listen_private_key_base64": key,
    }
    return {
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
        **{name: base64.b64encode(data).decode() for name, data in encoded.items()},
    }


def router_names(hosts: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """The routers by the names in their certificates, and where each answers."""
    if not hosts:
        return {ROUTER_NAME: _LOCAL}
    return {f"{ROUTER_NAME}-{host}": tuple(dict.fromkeys((host, *_LOCAL))) for host in hosts}


def make_keys(folder: Path, nodes: int, hosts: Sequence[str], days: int) -> list[str]:
    """Write the authority and one zenoh configuration per process; returns the names of the files.

    Raises:
        ValueError: numbers out of range, a bad host, a missing library, or a folder in use.
    """
    if not 1 <= nodes <= MAX_NODES:
        raise ValueError(f"--nodes {nodes}: a network has 1 to {MAX_NODES} nodes")
    if not 1 <= days <= MAX_DAYS:
        raise ValueError(f"--days {days}: certificates hold 1 to {MAX_DAYS} days")
    routers = router_names(checked_hosts(hosts))
    require_library()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(
            f"{folder} exists already; keys are never overwritten: name a new folder, or remove "
            "this one when no process uses its keys any more"
        )
    authority = new_authority(days)
    places = {**dict.fromkeys(rights(nodes), _LOCAL), **routers}
    files = {AUTHORITY: _authority_pem(authority), AUTHORITY_KEY: _key_pem(authority.key)}
    for name, at in places.items():
        pair = issue(authority, name, at, timedelta(days=days))
        config: dict[str, Any] = {
            "transport": {"link": {"tls": zenoh_settings(authority, *pair)}},
        }
        if name in routers:
            config["access_control"] = access_control(nodes, tuple(routers))
            config["low_pass_filter"] = size_limits()
        files[f"{name}.json"] = msgspec.json.format(msgspec.json.encode(config)) + b"\n"
    _write(folder, files)
    return sorted(files)


def _write(folder: Path, files: dict[str, bytes]) -> None:
    """All files, readable by their owner alone, or an error that names the folder."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)
        for name, data in files.items():
            mode = 0o644 if name == AUTHORITY else 0o600
            descriptor = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
    except OSError as error:
        raise ValueError(f"{folder}: cannot write keys there ({error.strerror})") from None


def faults_of_keys(folder: Path, now: datetime) -> dict[str, str]:
    """Return each zenoh configuration of a folder by its name, and what is wrong with it, "" for
    nothing: an expired certificate, another authority, a key of another certificate, readers.

    Raises:
        ValueError: there are none, or the library is missing.
    """
    require_library()
    files = sorted(folder.glob("*.json"))
    if not files:
        raise ValueError(f"{folder}: no keys there; `concord keys {folder} --nodes N` makes them")
    authorities: set[bytes] = set()
    faults = {}
    for file in files:
        try:
            config = msgspec.json.decode(file.read_bytes(), type=dict[str, Any])
            tls = config["transport"]["link"]["tls"]
            faults[file.name] = _fault_of_pair(tls, file.stem, now, authorities)
            check_private(file)
            if not config.get("access_control", {"enabled": True})["enabled"]:
                faults[file.name] = "its access control is off"
        except (OSError, ValueError, KeyError, TypeError) as error:
            faults[file.name] = f"not sound ({error})"
    return faults


def _fault_of_pair(tls: dict[str, str], name: str, now: datetime, authorities: set[bytes]) -> str:
    """Return what is wrong with a certificate and its key; note its authority."""
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives import serialization

    def decoded(what: str) -> bytes:
        return base64.b64decode(tls[f"{what}_base64"])

    certificate = x509.load_pem_x509_certificate(decoded("connect_certificate"))
    key = serialization.load_pem_private_key(decoded("connect_private_key"), None)
    authority = x509.load_pem_x509_certificate(decoded("root_ca_certificate"))
    authorities.add(decoded("root_ca_certificate"))
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, InvalidSignature):
        return "its certificate is of another authority than the one that it trusts"
    until = certificate.not_valid_after_utc
    if not certificate.not_valid_before_utc <= now <= until:
        return f"its certificate is valid until {until:%Y-%m-%d}, not now: make new keys"
    if certificate.public_key() != key.public_key():
        return "its key belongs to another certificate"
    if certificate.subject != _name(name):
        return f"its certificate is of {certificate.subject.rfc4514_string()}"
    return "" if len(authorities) == 1 else "it trusts another authority than the files before it"
