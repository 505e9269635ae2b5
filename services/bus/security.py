"""Mutual TLS on the bus: the certificate files of a process, and Zenoh's settings for them.

The folder holds ``ca.pem`` and, for each role that runs on this host, ``<role>.pem`` and ``<role>.key``. A role without
files cannot run here. ``ltv-mpc certs new`` creates the folder.
"""

from __future__ import annotations

import ssl
import stat
from pathlib import Path
from typing import Any, NamedTuple

from ltv_mpc.config import read_bytes
from ltv_mpc.errors import ConfigError

AUTHORITY = "ca.pem"
OPTION = "option --certs"


class Credentials(NamedTuple):
    """Certificate files of one role."""

    authority: Path
    certificate: Path
    key: Path


def credentials(folder: Path, role: str) -> Credentials:
    """Return the files of ``role``: they exist, key and certificate match, and only the owner can read the key.

    Raises ``ConfigError``.
    """
    files = Credentials(folder / AUTHORITY, folder / f"{role}.pem", folder / f"{role}.key")
    for file in files:
        if not file.exists():
            problem = f"no such file; `ltv-mpc certs new {folder}` makes certificates for every role"
            raise ConfigError(f"{OPTION} {file}", "", problem)
        read_bytes(file, what=OPTION)
    if stat.S_IMODE(files.key.stat().st_mode) & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError(f"{OPTION} {files.key}", "", "others may read this key: chmod 600")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(files.authority)
    except (ssl.SSLError, OSError) as error:
        raise ConfigError(f"{OPTION} {files.authority}", "", f"is not a PEM certificate: {error}") from None
    try:
        context.load_cert_chain(files.certificate, files.key)
    except (ssl.SSLError, OSError) as error:
        raise ConfigError(f"{OPTION} {files.certificate}", "", f"does not match {files.key.name}: {error}") from None
    return files


def roles_in(folder: Path, prefix: str) -> list[str]:
    """Return the roles whose names begin with ``prefix`` and whose certificates are in ``folder``."""
    return sorted(file.stem for file in folder.glob(f"{prefix}*.pem"))


def tls(files: Credentials) -> dict[str, Any]:
    """Return Zenoh's ``transport/link/tls``: both sides need a certificate of one authority; the host is verified."""
    return {
        "root_ca_certificate": str(files.authority),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "connect_certificate": str(files.certificate),
        "connect_private_key": str(files.key),
        "listen_certificate": str(files.certificate),
        "listen_private_key": str(files.key),
    }
