"""The credentials of a process in a secure network: its certificate and key, and the certificate of the authority."""

from __future__ import annotations

import base64
import logging
import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.regular_file import open_regular

LOG = logging.getLogger("keys")
PRIVATE_KEY, CERTIFICATE, CA = "key.pem", "cert.pem", "ca.pem"
"""The names of their files in the folder of the process."""
MOST_BYTES = 2**14
"""A longer file is not one of the three."""
_BOTH_ENDS = {"enable_mtls": True, "verify_name_on_connect": True}


@dataclass(frozen=True)
class Credentials:
    """The three credentials as PEM texts, in memory only."""

    of: str
    """the folder that they were read from, or the name of their owner; for messages"""
    authority: bytes
    certificate: bytes
    private_key: bytes = field(repr=False)

    @classmethod
    def read(cls, folder: Path) -> Credentials:
        """Return the credentials in a folder; raise UserError if one is missing or too long.

        Print a warning if every user of the machine may read the private key.
        """

        def text(name: str) -> bytes:
            try:
                with open_regular(folder / name) as file:
                    found = file.read(MOST_BYTES + 1)
                    for_all = os.fstat(file.fileno()).st_mode & stat.S_IROTH
            except OSError as error:
                raise UserError(f"no keys in {folder}: {name}: {error.strerror}", code=Code.FILE_UNREADABLE) from None
            if len(found) > MOST_BYTES:
                raise UserError(
                    f"no keys in {folder}: {name}: it is longer than {MOST_BYTES} bytes", code=Code.FILE_FORMAT
                )
            if for_all and name == PRIVATE_KEY:
                LOG.warning("%s: every user of this machine can read it; use chmod 600", folder / name)
            return found

        return cls(str(folder), text(CA), text(CERTIFICATE), text(PRIVATE_KEY))

    def tls(self) -> dict[str, object]:
        """Return the Zenoh settings of a link to a router of the same authority."""
        return {
            "root_ca_certificate_base64": _inline(self.authority),
            "connect_private_key_base64": _inline(self.private_key),
            "connect_certificate_base64": _inline(self.certificate),
            **_BOTH_ENDS,
        }

    def router_tls(self) -> dict[str, object]:
        """Return the Zenoh settings of the links of a router in this process.

        They hold no path: Zenoh copies them into an endpoint, which ends at `#` and `?`.
        """
        return {
            "root_ca_certificate_base64": _inline(self.authority),
            "listen_private_key_base64": _inline(self.private_key),
            "listen_certificate_base64": _inline(self.certificate),
            **_BOTH_ENDS,
        }


def carried_router_tls() -> dict[str, object]:
    """Return the Zenoh settings of the links of a router that starts in the folder of its credentials."""
    return {
        "root_ca_certificate": CA,
        "listen_private_key": PRIVATE_KEY,
        "listen_certificate": CERTIFICATE,
        **_BOTH_ENDS,
    }


def _inline(text: bytes) -> str:
    return base64.b64encode(text).decode()
