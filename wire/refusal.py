"""The reason why a router and a process refuse each other's certificates.

Zenoh reports only that there is no router.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import ssl
from collections.abc import Iterator

import zenoh

from hedgerow.wire.credentials import Credentials

CONNECT_S, ANSWER_S = 2.0, 1.0
"""The time limits to reach a router, and to wait for its refusal after it has our certificate."""
_WORDS = {
    "expired": "it has expired",
    "unknown ca": "it is of another authority",
    "unknownca": "it is of another authority",
    "unknownissuer": "it is of another authority",
    "decrypt": "it is of another authority",  # an authority of the same name, with another key
    "badsignature": "it is of another authority",
    "signature failure": "it is of another authority",
    "self-signed": "it is of another authority",
    "self signed": "it is of another authority",
    "unable to get local issuer": "it is of another authority",
    "not valid yet": "it does not hold yet: is the clock right?",
    "notvalidyet": "it does not hold yet: is the clock right?",
    "no certificate": "there is none",
    "certificate required": "there is none",
    "mismatch": "it is of another machine",
}
_LOGGED = re.compile(r"zenoh_link_tls\S*: (?P<why>.+)")


def address(endpoint: str) -> tuple[str, int]:
    """Return host and port of a Zenoh endpoint; raise ValueError if it has none."""
    host, _, port = endpoint.partition("/")[2].partition("?")[0].rpartition(":")
    return host.strip("[]"), int(port)


def refusal(endpoint: str, credentials: Credentials) -> str | None:
    """Return the reason why we and the router at `endpoint` refuse each other; None if they do not, or without a
    router.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(cadata=credentials.authority.decode(errors="replace"))
        with _readable(credentials.certificate) as certificate, _readable(credentials.private_key) as private_key:
            context.load_cert_chain(certificate, private_key)
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        return f"no keys in {credentials.of}: {getattr(error, 'reason', None) or error}"
    try:
        host, port = address(endpoint)
        with (
            socket.create_connection((host, port), CONNECT_S) as plain,
            context.wrap_socket(plain, server_hostname=host) as link,
        ):
            # The router checks our certificate after our side counts as connected.
            link.settimeout(ANSWER_S)
            link.recv(1)
    except ssl.SSLCertVerificationError as error:
        return f"we refuse the certificate of the router at {endpoint}: {_words(error.verify_message)}"
    except ssl.SSLError as error:
        if "ALERT" in (error.reason or ""):
            return f"the router at {endpoint} refuses the certificate in {credentials.of}: {_words(error.reason)}"
        if error.reason == "WRONG_VERSION_NUMBER":
            return f"the program at {endpoint} does not speak TLS"
    except (OSError, ValueError):
        pass  # there is no router, or it waits for our first message
    return None


@contextlib.contextmanager
def _readable(text: bytes) -> Iterator[str]:
    """Provide a path to a text for libraries that only read files.

    The text is in a pipe, so no file of it can remain.
    """
    out, into = os.pipe()
    try:
        with open(into, "wb") as pipe:
            pipe.write(text)
        yield f"/dev/fd/{out}"
    finally:
        os.close(out)


def log_refusals() -> None:
    """Make Zenoh log each client that a router of ours refuses, in one line each; `refused` reads these lines."""
    os.environ.setdefault("NO_COLOR", "1")
    rules = f"{os.environ.get('RUST_LOG', 'off')},zenoh_link_tls=warn"
    os.environ["RUST_LOG"] = rules
    zenoh.init_log_from_env_or(rules)


def refused(line: str) -> str | None:
    """Return the refusal in a line of the log, by our router or of our certificate; None for other lines."""
    found = _LOGGED.search(line)
    if found is None:
        return None
    why = found["why"]
    if "handshake eof" in why:  # for example a port scan: it showed no certificate
        return "a client connected and left without a handshake"
    who = "a client refused our certificate" if "alert" in why else "our router refused a certificate"
    return f"{who}: {_words(why)}"


def _words(reason: str) -> str:
    """Return a library's reason in our words."""
    plain = reason.lower().replace("_", " ")
    return next((words for sign, words in _WORDS.items() if sign in plain), plain)
