"""Signatures of XML documents (W3C XML Signature, enveloped) with an X.509 certificate: checked and made."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key
from lxml import etree
from signxml.algorithms import SignatureMethod
from signxml.exceptions import InvalidCertificate, SignXMLException
from signxml.signer import XMLSigner
from signxml.verifier import SignatureConfiguration, VerifyResult, XMLVerifier

from agent.files import translated
from agent.printable import one_line
from agent.settings.credentials import handed_over, open_mode
from drivers.errors import ConfigurationError, InputError
from twin.formats.digital_certificate.xml_reading import DS, child, children, parse_xml

_LONGEST_NAME: Final = 120
_FAILURES: Final = (
    SignXMLException, InvalidSignature, UnsupportedAlgorithm, etree.LxmlError,
    ValueError, LookupError, TypeError, AttributeError, AssertionError,
)  # fmt: skip
"""What signxml and its libraries raise for a signature that is damaged or of a kind that they do not know."""

PrivateKey = rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey


class Trust(Enum):
    """Statement of a signature about a document."""

    UNSIGNED = "not signed"
    UNKNOWN_SIGNER = "signed by somebody who is not known to be trusted"
    TRUSTED = "signed by a trusted signer"


@dataclass(frozen=True)
class CheckedDocument:
    """Document whose signature was checked. `content` is what was signed, or the whole document if it is not signed.
    `signer` is the subject of the signer's certificate with its fingerprint; it is empty if there is none."""

    content: bytes
    trust: Trust
    signer: str = ""

    @property
    def text(self) -> str:
        """State of the signature in words."""
        return self.trust.value if not self.signer else f"{self.trust.value}: {self.signer}"


def check_signature(content: bytes, source: str, trusted: Sequence[Path] = ()) -> CheckedDocument:
    """Return the signed part of the XML document `content`, and who signed it.

    `trusted` are files with certificates (PEM) of signers, or of authorities that certify signers. A signature is
    always checked: InputError is raised if the document was changed since it was signed, or if the signature cannot be
    checked. It is also raised if `trusted` is not empty and no trusted signer has signed the whole document.
    """
    known = [certificate for path in trusted for certificate in _certificates(path)]
    with translated(InputError):
        root = parse_xml(content, source)
    signatures = children(root, DS, "Signature")
    if not signatures:
        if known:
            raise InputError(
                "the document is not signed",
                hint="ask for a signed one, or leave out --trusted and check its origin yourself",
                file=source,
            )
        return CheckedDocument(content, Trust.UNSIGNED)
    if len(signatures) > 1:
        raise InputError(
            f"the document has {len(signatures)} signatures, and only one can be checked",
            hint="ask the laboratory for the certificate with its own signature alone",
            file=source,
        )
    leaf = _embedded(signatures[0], source)
    named = f"{one_line(leaf.subject.rfc4514_string(), _LONGEST_NAME)}, SHA-256 {leaf.fingerprint(SHA256()).hex()}"
    signed = _signed_part(root.tag, _verified(content, leaf, source), source)
    if leaf in known:
        return CheckedDocument(signed, Trust.TRUSTED, named)
    if not known:
        return CheckedDocument(signed, Trust.UNKNOWN_SIGNER, named)
    _check_chain(content, trusted, named, source)
    return CheckedDocument(signed, Trust.TRUSTED, named)


def _verified(content: bytes, leaf: x509.Certificate, source: str) -> list[VerifyResult]:
    """Return what the signature covers, if it was made with the key of the certificate `leaf`. Its time of validity
    does not matter here: the document was signed earlier."""
    config = SignatureConfiguration(location="./", expect_references=False, verification_time=leaf.not_valid_before_utc)
    try:
        found = XMLVerifier().verify(content, x509_cert=leaf, expect_config=config)
    except _FAILURES as error:
        told = one_line(str(error) or type(error).__name__, _LONGEST_NAME)
        raise InputError(
            f"the signature is not valid: {told}",
            hint="the document was changed or damaged after it was signed; ask for it again",
            file=source,
        ) from None
    return found if isinstance(found, list) else [found]


def _signed_part(tag: str, found: Sequence[VerifyResult], source: str) -> bytes:
    """Return the signed text whose root element is that of the document."""
    for one in found:
        if one.signed_xml is not None and one.signed_xml.tag == tag:
            return one.signed_data
    raise InputError("the signature does not cover the whole document", file=source)


def _check_chain(content: bytes, trusted: Sequence[Path], named: str, source: str) -> None:
    """Raise InputError unless one of the files has the authority that certifies the signer."""
    told = ""
    for path in trusted:
        try:
            config = SignatureConfiguration(location="./", expect_references=False)
            XMLVerifier().verify(content, ca_pem_file=str(path), expect_config=config)
        except InvalidCertificate as error:
            told = one_line(str(error), _LONGEST_NAME)
        except _FAILURES as error:
            told = one_line(str(error) or type(error).__name__, _LONGEST_NAME)
        else:
            return
    raise InputError(
        f"the signer is not trusted: {named}",
        hint=f"pass the certificate of the signer or of its authority with --trusted ({told})",
        file=source,
    )


def _embedded(signature: etree._Element, source: str) -> x509.Certificate:
    """Return the first certificate in a signature, which is that of the signer."""
    info = child(signature, DS, "KeyInfo")
    data = None if info is None else child(info, DS, "X509Data")
    held = None if data is None else child(data, DS, "X509Certificate")
    if held is None:
        raise InputError("the signature has no certificate of its signer", file=source)
    body = "".join((held.text or "").split())
    try:
        return x509.load_pem_x509_certificate(
            f"-----BEGIN CERTIFICATE-----\n{body}\n-----END CERTIFICATE-----\n".encode("ascii")
        )
    except (ValueError, UnsupportedAlgorithm) as error:
        told = one_line(str(error), _LONGEST_NAME)
        raise InputError(f"the certificate of the signer cannot be read: {told}", file=source) from None


def _certificates(path: Path) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(path.read_bytes())
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror or error}", file=str(path)) from None
    except (ValueError, UnsupportedAlgorithm):
        raise InputError(
            "the file has no certificate in PEM form",
            hint="it must begin with -----BEGIN CERTIFICATE-----",
            file=str(path),
        ) from None


@dataclass(frozen=True)
class Signer:
    """Private key of a signer with its certificate, followed by those of the authorities between it and the root."""

    key: PrivateKey
    chain: tuple[x509.Certificate, ...]

    @classmethod
    def read(cls, key_file: Path, certificate_file: Path, now: datetime.datetime) -> Signer:
        """Return the signer of two files in PEM form.

        Raise ConfigurationError if one cannot be used, if they do not belong together, or if the certificate is not
        valid at the time `now`.
        """
        key = _private_key(key_file)
        try:
            chain = tuple(_certificates(certificate_file))
        except InputError as error:
            raise ConfigurationError(error.message, hint=error.hint, **error.where) from None
        if _public(chain[0]) != key.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo):
            raise ConfigurationError(
                "the certificate is not that of the key",
                hint=f"the first certificate of the file must belong to {key_file}",
                file=str(certificate_file),
            )
        if not chain[0].not_valid_before_utc <= now <= chain[0].not_valid_after_utc:
            raise ConfigurationError(
                f"the certificate is valid from {chain[0].not_valid_before_utc:%Y-%m-%d} to "
                f"{chain[0].not_valid_after_utc:%Y-%m-%d} only",
                hint="sign with a certificate that is valid",
                file=str(certificate_file),
            )
        return cls(key, chain)

    def signed(self, root: etree._Element) -> etree._Element:
        """Return a copy of the document with an enveloped signature as its last element."""
        method = SignatureMethod.RSA_SHA256 if isinstance(self.key, rsa.RSAPrivateKey) else SignatureMethod.ECDSA_SHA256
        return XMLSigner(signature_algorithm=method).sign(root, key=self.key, cert=list(self.chain))


CREDENTIAL: Final = "certificate-key"
"""Credential of systemd with the private key."""


def signer_of(
    key_file: Path | None, certificate_file: Path | None, now: datetime.datetime, *, key_is_stated: bool
) -> Signer | None:
    """Return the signer of the settings or of the command line; None if neither a key nor a certificate is stated.

    A key that systemd has passed comes before that of the settings, but not before one that the command line states
    (`key_is_stated`). Raise ConfigurationError if only one of the two is stated, if other users than its owner can read
    the key, or if the two cannot be used (`Signer.read`).
    """
    key = key_file if key_is_stated else handed_over(CREDENTIAL) or key_file
    if key is None and certificate_file is None:
        return None
    if key is None or certificate_file is None:
        absent = "key_file" if key is None else "certificate_file"
        raise ConfigurationError(
            "a signature needs both a key and its certificate",
            key=f"report.signature.{absent}",
            hint="state both files, or neither",
        )
    if key.exists() and (mode := open_mode(key)) is not None:
        raise ConfigurationError(
            f"the file of a secret can be read by others (mode {mode:04o})", hint=f"chmod 600 {key}", file=str(key)
        )
    return Signer.read(key, certificate_file, now)


def _public(certificate: x509.Certificate) -> bytes:
    return certificate.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


def _private_key(path: Path) -> PrivateKey:
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise ConfigurationError(f"the file cannot be read: {error.strerror or error}", file=str(path)) from None
    except TypeError:
        raise ConfigurationError(
            "the key is encrypted with a passphrase, which cannot be asked for here",
            hint="store it without one in a file of mode 600, or pass it as a credential of systemd",
            file=str(path),
        ) from None
    except (ValueError, UnsupportedAlgorithm):
        raise ConfigurationError("the file has no private key in PEM form", file=str(path)) from None
    if not isinstance(key, rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey):
        raise ConfigurationError(
            "the key is of a kind that does not sign XML", hint="use an RSA or an ECDSA key", file=str(path)
        )
    return key
