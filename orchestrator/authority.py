"""An authority and a certificate for each process, made for one network; the authority's own key is kept nowhere."""

from __future__ import annotations

import contextlib
import ipaddress
import json
import os
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topologies.errors import UserError
from wire import keys
from wire.access import OBSERVER, ROUTER, Place, access_control, rights
from wire.session import ACCESS, CA, CERTIFICATE, PRIVATE_KEY, base_settings, remove_secrets, router_settings

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import Certificate, Name

LIFE_DAYS = 7
"""How long a certificate holds: a process that starts again later is refused."""
SLACK = timedelta(minutes=5)
"""How far the clock of a machine may be behind ours."""
SETTINGS, CONFIGURATION = "settings.json", "zenohd.json5"


class Authority:
    """Signs certificates; whoever holds one of them may connect, under the name in it."""

    def __init__(self, days: float = LIFE_DAYS) -> None:
        """Raises UserError where the library for it is not installed."""
        try:
            from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
        except ImportError:
            raise UserError(
                "--secure: needs the library cryptography; install it with: pip install 'hedgerow[secure]'"
            ) from None
        now = datetime.now(UTC)
        self._from, self._to = now - SLACK, now + timedelta(days=days)
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = _named("hedgerow")
        self._certificate = self._signed(self._name, self._key, authority=True)

    def issue(self, folder: Path, name: str, host: str | None = None) -> None:
        """Write the credentials of a process into a new folder of theirs; `host` is where it listens, if it does."""
        from cryptography.hazmat.primitives import serialization  # noqa: PLC0415
        from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415

        own = ec.generate_private_key(ec.SECP256R1())
        pem = serialization.Encoding.PEM
        folder.mkdir(mode=0o700)
        private = own.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
        _write(folder / PRIVATE_KEY, private)
        _write(folder / CERTIFICATE, self._signed(_named(name), own, host=host).public_bytes(pem))
        _write(folder / CA, self._certificate.public_bytes(pem))

    def _signed(
        self, name: Name, own: EllipticCurvePrivateKey, authority: bool = False, host: str | None = None
    ) -> Certificate:
        from cryptography import x509  # noqa: PLC0415
        from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
        from cryptography.x509 import oid  # noqa: PLC0415

        builder = (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(self._name)
            .public_key(own.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(self._from)
            .not_valid_after(self._to)
            .add_extension(x509.BasicConstraints(ca=authority, path_length=0 if authority else None), critical=True)
        )
        if host is not None:
            builder = builder.add_extension(x509.SubjectAlternativeName([_address(host)]), critical=False)
        else:
            # Who may not listen cannot play the router to others, whose name it does not bear.
            role = x509.ExtendedKeyUsage([oid.ExtendedKeyUsageOID.CLIENT_AUTH])
            builder = builder if authority else builder.add_extension(role, critical=False)
        return builder.sign(self._key, hashes.SHA256())


def _named(name: str) -> Name:
    from cryptography import x509  # noqa: PLC0415

    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])


def _address(host: str) -> Any:
    from cryptography import x509  # noqa: PLC0415

    with contextlib.suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(host))
    return x509.DNSName(host)


def _write(path: Path, content: bytes) -> None:
    """Write a file that nobody else could ever read."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


@contextlib.contextmanager
def for_this_run(folder: Path, places: Sequence[Place], namespace: str) -> Iterator[Path]:
    """Credentials of a run whose router is its plant, on this machine, while the block lasts."""
    authority = Authority()
    folder.mkdir(mode=0o700)
    try:
        granted = rights(places)
        # The plant is no client of a router that it is itself: nobody comes in by its name.
        del granted[keys.PLANT]
        authority.issue(folder / keys.PLANT, keys.PLANT, host="127.0.0.1")
        _write(folder / keys.PLANT / ACCESS, json.dumps(access_control(granted, namespace)).encode())
        for name in granted:
            authority.issue(folder / name, name)
        yield folder
    finally:
        remove_secrets(folder)


def to_carry(folder: Path, places: Sequence[Place], namespace: str, endpoint: str, days: float) -> list[str]:
    """Credentials for a router that stands elsewhere: one folder a process, and the router's; returns their names."""
    authority = Authority(days)
    host = host_of(endpoint)
    try:
        folder.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        raise UserError(f"--out {folder}: is there already; name a new folder") from None
    granted = rights(places)
    settings = json.dumps({"endpoint": endpoint, "namespace": namespace}, indent=1) + "\n"
    for name in granted:
        authority.issue(folder / name, name)
        _write(folder / name / SETTINGS, settings.encode())
    authority.issue(folder / ROUTER, ROUTER, host=host)
    port = endpoint.rpartition(":")[2]
    # Its own certificate lies beside the file: it is to be started there.
    configuration = base_settings() | router_settings(f"tls/0.0.0.0:{port}", Path(), access_control(granted, namespace))
    said = f"// zenohd -c {CONFIGURATION}, in this folder\n{json.dumps(nested(configuration), indent=1)}\n"
    _write(folder / ROUTER / CONFIGURATION, said.encode())
    return [*granted, ROUTER]


def carried(folder: Path, places: Sequence[Place]) -> tuple[str, str]:
    """The endpoint and the namespace that credentials in a folder were made for; UserError if not for this network."""
    again = f"make it with: orchestrator keys FILE --out {folder}"
    try:
        settings = json.loads((folder / OBSERVER / SETTINGS).read_text(encoding="utf-8"))
        endpoint, namespace = settings["endpoint"], settings["namespace"]
        text = (folder / ROUTER / CONFIGURATION).read_text(encoding="utf-8").partition("\n")[2]
        known = json.loads(text)["access_control"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"--keys {folder}: no folder of keys: {type(error).__name__}: {error}; {again}") from None
    if known != json.loads(json.dumps(access_control(rights(places), namespace))):
        raise UserError(f"--keys {folder}: made for another network, or other processes; {again}")
    return endpoint, namespace


def host_of(endpoint: str) -> str:
    """The host of a TLS endpoint; UserError for any other."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tls" or not host or not port.isdigit():
        raise UserError(f"--router {endpoint}: a secure network needs a router that speaks TLS: tls/HOST:PORT")
    return host.strip("[]")


def nested(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings by path as a tree."""
    tree: dict[str, Any] = {}
    for path, value in settings.items():
        *above, last = path.split("/")
        branch = tree
        for name in above:
            branch = branch.setdefault(name, {})
        branch[last] = value
    return tree
