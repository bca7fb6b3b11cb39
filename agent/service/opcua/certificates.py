"""OPC UA certificates. They comprise the server's own certificate, which is generated when the server first starts, and
the certificates of the trusted clients."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from drivers.errors import ConfigurationError
from drivers.foreign_errors import cause_of

VALIDITY: Final = timedelta(days=3650)
CLOCK_TOLERANCE: Final = timedelta(days=1)
"""Time by which the certificate is backdated, so that a client whose clock is slow accepts it."""


@dataclass(frozen=True)
class OwnCertificate:
    certificate: Path
    key: Path


def own_certificate(directory: Path, application_uri: str, host_name: str, address: str) -> OwnCertificate:
    """Return the server's certificate and private key, which are stored in `directory`. If they are missing, generate
    them; the key file has mode 0600.

    Raise ConfigurationError if they cannot be read or written, or if the certificate has expired.
    """
    own = OwnCertificate(directory / "own" / "certificate.der", directory / "own" / "key.pem")
    if own.certificate.exists() and own.key.exists():
        _refuse_expired(own.certificate)
        return own
    try:
        own.key.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
        _write(own.key, _pem(key), 0o600)
        certificate = _self_signed(key, application_uri, host_name, address)
        _write(own.certificate, certificate.public_bytes(serialization.Encoding.DER), 0o644)
    except OSError as error:
        raise ConfigurationError(
            f"the OPC UA certificate cannot be written: {cause_of(error)}", file=str(own.certificate)
        ) from error
    return own


def is_trusted(certificate: bytes | None, directory: Path) -> bool:
    """Return True if `directory` contains exactly this certificate (DER) and the certificate is currently valid.

    The directory is read at each call, so that a client can be admitted or excluded without a restart.
    """
    if certificate is None:
        return False
    return any(_der(known) == certificate and _valid_today(known) for known in _certificates_in(directory))


def _certificates_in(directory: Path) -> Iterable[x509.Certificate]:
    """Yield the certificates in the directory. Other files, such as a README or an incomplete copy, are ignored."""
    for path in sorted(directory.glob("*")) if directory.is_dir() else ():
        if path.is_file():
            try:
                yield _load(path)
            except (OSError, ValueError):
                continue


def _load(path: Path) -> x509.Certificate:
    data = path.read_bytes()
    try:
        if data.lstrip().startswith(b"-----BEGIN"):
            return x509.load_pem_x509_certificate(data)
        return x509.load_der_x509_certificate(data)
    except x509.InvalidVersion as error:  # alone among its errors, no ValueError
        raise ValueError(str(error)) from None


def _der(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.DER)


def _valid_today(certificate: x509.Certificate) -> bool:
    return certificate.not_valid_before_utc <= datetime.now(UTC) <= certificate.not_valid_after_utc


def _refuse_expired(path: Path) -> None:
    try:
        certificate = _load(path)
    except (OSError, ValueError) as error:
        reason = cause_of(error) if isinstance(error, OSError) else "it is not a certificate"
        raise ConfigurationError(
            f"the server's OPC UA certificate cannot be read: {reason}",
            hint="remove it together with its key; a new one is generated, which the clients must then trust",
            file=str(path),
        ) from error
    if not _valid_today(certificate):
        raise ConfigurationError(
            f"the server's OPC UA certificate is valid until {certificate.not_valid_after_utc:%Y-%m-%d}",
            hint="set the clock, or remove it together with its key; the clients must then trust the new one",
            file=str(path),
        )


def _self_signed(key: rsa.RSAPrivateKey, uri: str, host_name: str, address: str) -> x509.Certificate:
    """Return a self-signed certificate of an application instance as specified in OPC 10000-6, 6.2.2.

    It contains the application URI, host name and address, and the key usages.
    """
    name = x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, "volcal"), x509.NameAttribute(NameOID.ORGANIZATION_NAME, host_name)]
    )
    names: list[x509.GeneralName] = [
        x509.UniformResourceIdentifier(uri),
        x509.DNSName(host_name),
        x509.IPAddress(ipaddress.ip_address(address)),
    ]
    usage = x509.KeyUsage(
        digital_signature=True, content_commitment=True, key_encipherment=True, data_encipherment=True,
        key_agreement=False, key_cert_sign=True, crl_sign=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_TOLERANCE)
        .not_valid_after(now + VALIDITY)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )


def _pem(key: rsa.RSAPrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(path: Path, data: bytes, mode: int) -> None:
    """Write a file that has `mode` from its creation on, so that a key is at no time readable by others."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
