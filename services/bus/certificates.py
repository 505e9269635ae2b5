"""Certificates for mutual TLS: an own authority, and a key and a signed certificate for each role.

Keys are elliptic (P-256). A certificate's common name is its role (``roles.py``). It serves for both ends of a
connection, as Zenoh's links need, and names the hosts at which a router may listen with it. The authority's key is
discarded after signing: nobody can derive another role from a copied folder, and a new vehicle gets new certificates.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
from collections.abc import Iterable
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from services.bus.security import AUTHORITY

LOOPBACK = ("localhost", "127.0.0.1", "::1")
BACKDATED = datetime.timedelta(days=1)
"""Start of validity before now: the clock of a vehicle that has just been switched on may be slow."""


def make(folder: Path, roles: Iterable[str], *, hosts: Iterable[str] = (), days: int) -> list[Path]:
    """Write ``ca.pem``, and ``<role>.pem`` and ``<role>.key`` of each role, into ``folder``; return the paths.

    Only the owner may read the folder (0700) and the files (0600). ``hosts`` are the names or addresses of the router
    in addition to loopback. Existing files of these names are replaced.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder.chmod(0o700)
    names = [_general_name(host) for host in dict.fromkeys((*LOOPBACK, *hosts))]
    authority = _Authority(days)
    files = [folder / AUTHORITY]
    _write(files[0], authority.certificate.public_bytes(Encoding.PEM))
    for role in roles:
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = authority.signed(
            _common_name(role),
            key,
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]),
            x509.SubjectAlternativeName(names),
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()),
        )
        files += [folder / f"{role}.pem", folder / f"{role}.key"]
        _write(files[-2], certificate.public_bytes(Encoding.PEM))
        _write(files[-1], key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return files


class _Authority:
    """Authority with its key, whose own certificate and those that it signs are valid for the same time."""

    def __init__(self, days: int) -> None:
        now = datetime.datetime.now(datetime.UTC)
        self._valid = now - BACKDATED, now + datetime.timedelta(days=days)
        self._name = _common_name("ltv-mpc certificates")
        self.key = ec.generate_private_key(ec.SECP256R1())
        own_key = x509.SubjectKeyIdentifier.from_public_key(self.key.public_key())
        self.certificate = self.signed(self._name, self.key, own_key, signs=True)

    def signed(
        self, name: x509.Name, key: ec.EllipticCurvePrivateKey, *extensions: x509.ExtensionType, signs: bool = False
    ) -> x509.Certificate:
        """Return a certificate of a key; ``signs``: others may be signed with it."""
        builder = (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(self._name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(self._valid[0])
            .not_valid_after(self._valid[1])
            .add_extension(x509.BasicConstraints(ca=signs, path_length=0 if signs else None), critical=True)
            .add_extension(_key_usage(signs=signs), critical=True)
        )
        for extension in extensions:
            builder = builder.add_extension(extension, critical=False)
        return builder.sign(self.key, hashes.SHA256())


def _key_usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _common_name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _write(path: Path, content: bytes) -> None:
    """Write a file atomically; others cannot read it at any time."""
    fresh = path.with_name(f".{path.name}.new")
    fresh.unlink(missing_ok=True)
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)
    fresh.replace(path)
