"""What a process shows to a secure router, and whom it believes: a certificate, its private key and the authority's."""

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
"""Their files in a folder of the process's own."""
MOST_BYTES = 2**14
"""What is longer is none of them."""
_BOTH_ENDS = {"enable_mtls": True, "verify_name_on_connect": True}


@dataclass(frozen=True)
class Credentials:
    """The three, as PEM texts that stand in memory alone."""

    of: str
    """where they were read, or for whom they were made; for people"""
    authority: bytes
    certificate: bytes
    private_key: bytes = field(repr=False)

    @classmethod
    def read(cls, folder: Path) -> Credentials:
        """Those in a folder; UserError where one is missing or too long. Says if all may read the private key."""

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
                LOG.warning("%s: everybody here may read it, and speak for its owner; chmod 600", folder / name)
            return found

        return cls(str(folder), text(CA), text(CERTIFICATE), text(PRIVATE_KEY))

    def tls(self) -> dict[str, object]:
        """Settings of a link of Zenoh's at whose other end is a router of the same authority."""
        return {
            "root_ca_certificate_base64": _inline(self.authority),
            "connect_private_key_base64": _inline(self.private_key),
            "connect_certificate_base64": _inline(self.certificate),
            **_BOTH_ENDS,
        }


def router_tls(folder: Path) -> dict[str, object]:
    """Settings of the links of the router whose credentials lie in `folder`."""
    return {
        "root_ca_certificate": str(folder / CA),
        "listen_private_key": str(folder / PRIVATE_KEY),
        "listen_certificate": str(folder / CERTIFICATE),
        **_BOTH_ENDS,
    }


def _inline(text: bytes) -> str:
    return base64.b64encode(text).decode()
