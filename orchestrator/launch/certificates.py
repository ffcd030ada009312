"""An authority and a certificate for each process of one network; the key of the authority is never stored."""

from __future__ import annotations

import contextlib
import hashlib
import ipaddress
import json
import os
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hedgerow.orchestrator.runs.folder import whole_folder
from hedgerow.plant.request import BYTES_PER_INCIDENCE, LEAST_BYTES
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.json_file import read_json
from hedgerow.wire import keys
from hedgerow.wire.access import OBSERVER, ROUTER, Place, rights, rules
from hedgerow.wire.credentials import CA, CERTIFICATE, PRIVATE_KEY, carried_router_tls
from hedgerow.wire.session import ACCESS, base_settings, remove_trace, router_settings

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import Certificate, Name

LIFE_DAYS = 7
"""The validity of a certificate [days]; a process that starts again later is refused."""
SLACK = timedelta(minutes=5)
"""The maximum lag of another machine's clock behind ours."""
HERE = ("127.0.0.1", "localhost")
"""More names of a router, for processes on its own machine."""
SETTINGS, CONFIGURATION = "settings.json", "zenohd.json5"


class Authority:
    """An authority that signs certificates; the holder of one may connect under the name in it."""

    def __init__(self, days: float = LIFE_DAYS) -> None:
        """Make the keys; raise UserError if the library is not installed."""
        try:
            from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
        except ImportError:
            raise UserError(
                "--secure: needs cryptography. Install it with: pip install cryptography", code=Code.DEPENDENCY
            ) from None
        now = datetime.now(UTC)
        self._from, self.until = now - SLACK, now + timedelta(days=days)
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = _named("hedgerow")
        self._certificate = self._signed(self._name, self._key, authority=True)

    def issue(self, folder: Path, name: str, host: str | None = None) -> None:
        """Write the credentials of a process into a new folder; `host` is its address if it listens."""
        from cryptography.hazmat.primitives import serialization  # noqa: PLC0415
        from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415

        own = ec.generate_private_key(ec.SECP256R1())
        pem = serialization.Encoding.PEM
        folder.mkdir(mode=0o700)
        private = own.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
        write_private(folder / PRIVATE_KEY, private)
        write_private(folder / CERTIFICATE, self._signed(_named(name), own, host=host).public_bytes(pem))
        write_private(folder / CA, self._certificate.public_bytes(pem))

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
            .not_valid_after(self.until)
            .add_extension(x509.BasicConstraints(ca=authority, path_length=0 if authority else None), critical=True)
        )
        if host is not None:
            names = [_address(one) for one in dict.fromkeys((host, *HERE))]
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        else:
            # A client certificate cannot serve: its holder cannot pretend to be the router.
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


def write_private(path: Path, content: bytes) -> None:
    """Write a file that only its owner can ever read."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
    except BaseException:  # an incomplete file is useless
        path.unlink()
        raise


@contextlib.contextmanager
def for_this_run(folder: Path, places: Sequence[Place], namespace: str, host: str) -> Iterator[Path]:
    """Provide the credentials of a run while the block lasts; its plant is the router, on this machine, at `host`."""
    authority = Authority()
    folder.mkdir(mode=0o700)
    try:
        authority.issue(folder / ROUTER, ROUTER, host=host)
        most = LEAST_BYTES + BYTES_PER_INCIDENCE * sum(place.incidences for place in places)
        access_rules = rules(places, namespace, plant_is_client=False, request_bytes=most)
        write_private(folder / ROUTER / ACCESS, json.dumps(access_rules).encode())
        # The plant is the router itself, so no client may connect under its name.
        for name in rights(places).keys() - {keys.PLANT}:
            authority.issue(folder / name, name)
        yield folder
    finally:
        remove_trace(folder)


def to_carry(
    folder: Path,
    places: Sequence[Place],
    namespace: str,
    endpoint: str,
    days: float,
    more: Callable[[Path], None] = lambda _: None,
) -> list[str]:
    """Write credentials for processes on other machines: one folder per process, and one for the router.

    Return the names.

    The router may be a separate one, or our own plant. `more` writes further files into the folder, which is complete
    or absent.
    """
    authority = Authority(days)
    host = host_of(endpoint)
    _check_host(host, endpoint)
    granted = rights(places)
    access_rules = rules(places, namespace, plant_is_client=True)
    until = authority.until.isoformat(timespec="seconds")
    settings = {"endpoint": endpoint, "namespace": namespace, "rules": _digest(access_rules), "until": until}
    port = endpoint.rpartition(":")[2]
    # The certificate of the router is beside the file, because the router starts in that folder.
    configuration = base_settings() | router_settings(f"tls/0.0.0.0:{port}", carried_router_tls(), access_rules)
    text = f"// zenohd -c {CONFIGURATION}, in this folder\n{json.dumps(nested(configuration), indent=1)}\n"
    try:
        with whole_folder(folder, str(folder), 0o700) as part:
            for name in granted:
                authority.issue(part / name, name)
                write_private(part / name / SETTINGS, (json.dumps(settings, indent=1) + "\n").encode())
            authority.issue(part / ROUTER, ROUTER, host=host)
            write_private(part / ROUTER / CONFIGURATION, text.encode())
            write_private(part / ROUTER / ACCESS, json.dumps(access_rules).encode())
            more(part)
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}; choose another folder", code=Code.OUTPUT) from None
    return [*granted, ROUTER]


def _check_host(host: str, endpoint: str) -> None:
    """Raise UserError for a host that cannot be in a certificate."""
    try:
        _address(host)
    except ValueError:
        raise UserError(
            f"--router {endpoint}: a certificate cannot name {host}; write it in ASCII, or as an address"
        ) from None


def carried(folder: Path, places: Sequence[Place]) -> tuple[str, str]:
    """Return the endpoint and the namespace of the credentials in a folder; raise UserError if they are for another
    network.
    """
    again = "`orchestrator keys` and `orchestrator bundle --secure` make one"
    try:
        settings = read_json(folder / OBSERVER / SETTINGS)
        endpoint, namespace, made_for = settings["endpoint"], settings["namespace"], settings["rules"]
        until = datetime.fromisoformat(settings["until"])
        if not isinstance(endpoint, str) or not isinstance(namespace, str) or until.tzinfo is None:
            raise TypeError("settings of another form")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"--keys {folder}: no folder of keys: {type(error).__name__}: {error}; {again}", code=Code.FILE_FORMAT
        ) from None
    if made_for != _digest(rules(places, namespace, plant_is_client=True)):
        raise UserError(f"--keys {folder}: made for another network, other processes, or by another release; {again}")
    if datetime.now(UTC) > until:
        raise UserError(f"--keys {folder}: they held until {until:%Y-%m-%d %H:%M} UTC; {again}")
    return endpoint, namespace


def _digest(access_rules: object) -> str:
    """Return the fingerprint of a router's rules."""
    return hashlib.sha256(json.dumps(access_rules).encode()).hexdigest()[:16]


def host_of(endpoint: str, option: str = "--router") -> str:
    """Return the host of a TLS endpoint; raise UserError for any other."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tls" or not host or not port.isdigit():
        raise UserError(
            f"{option} {endpoint}: a secure network needs a router that speaks TLS: tls/HOST:PORT", code=Code.OPTION
        )
    return host.strip("[]")


def nested(settings: dict[str, Any]) -> dict[str, Any]:
    """Return settings by path as a tree."""
    tree: dict[str, Any] = {}
    for path, value in settings.items():
        *above, last = path.split("/")
        branch = tree
        for name in above:
            branch = branch.setdefault(name, {})
        branch[last] = value
    return tree
