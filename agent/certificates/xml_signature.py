"""Signatures of XML documents (W3C XML Signature, enveloped) with an X.509 certificate: checked and made."""

from __future__ import annotations

import datetime
import warnings
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
from signxml.exceptions import SignXMLException
from signxml.signer import XMLSigner
from signxml.verifier import SignatureConfiguration, VerifyResult, XMLVerifier

from agent.certificates.signing_authority import check_authority
from agent.files import translated
from agent.printable import one_line
from agent.settings.credentials import handed_over, open_mode
from drivers.errors import ConfigurationError, InputError
from twin.formats.digital_certificate.xml_reading import DS, child, children, parse_xml

_LONGEST_NAME: Final = 120
_LONGEST_SUBJECT: Final = 80
_MOST_REFERENCES: Final = 3  # the document, the properties of XAdES, and the key
_MOST_TRANSFORMS: Final = 6
_MOST_CERTIFICATES: Final = 10
_FAILURES: Final = (
    SignXMLException, InvalidSignature, UnsupportedAlgorithm, etree.LxmlError,
    ValueError, LookupError, TypeError, AttributeError, AssertionError,
)  # fmt: skip
"""What signxml and its libraries raise for a signature that is damaged or of a kind that they do not know."""
_UNREADABLE: Final = (ValueError, TypeError, UnsupportedAlgorithm, x509.InvalidVersion, Warning)
"""What reading a certificate raises if it is damaged, of an unknown kind, or not as RFC 5280 requires."""

PrivateKey = rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey


class Trust(Enum):
    """Statement of a signature about a document."""

    UNSIGNED = "not signed"
    UNKNOWN_SIGNER = "signed by somebody who is not known to be trusted"
    TRUSTED = "signed by a trusted signer"


@dataclass(frozen=True)
class CheckedDocument:
    """Document whose signature was checked. `content` is what was signed, or the whole document if it is not signed.
    `signer` is the subject of the signer's certificate with its fingerprint, and `valid` the first and the last day of
    its validity; they are empty and None if there is none."""

    content: bytes
    trust: Trust
    signer: str = ""
    valid: tuple[datetime.date, datetime.date] | None = None

    @property
    def text(self) -> str:
        """State of the signature in words."""
        return self.trust.value if not self.signer else f"{self.trust.value}: {self.signer}"


def check_signature(content: bytes, source: str, trusted: Sequence[Path] = ()) -> CheckedDocument:
    """Return the signed part of the XML document `content`, and who signed it.

    `trusted` are files with certificates (PEM) of signers, or of authorities that certify signers. A signature is
    always checked: InputError is raised if the document was changed since it was signed, or if the signature cannot be
    checked. It is also raised if `trusted` is not empty and no trusted signer has signed the whole document. A signer's
    certificate may have expired since: compare `valid` with the date of the document.
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
    _check_size(signatures[0], source)
    leaf, others, verified = _verified(content, _embedded(signatures[0], source), source)
    subject = one_line(leaf.subject.rfc4514_string().replace(";", ","), _LONGEST_SUBJECT)
    named = f"{subject}, SHA-256 {leaf.fingerprint(SHA256()).hex()}"
    signed = _signed_part(root.tag, verified, source)
    valid = leaf.not_valid_before_utc.date(), leaf.not_valid_after_utc.date()
    if not known:
        return CheckedDocument(signed, Trust.UNKNOWN_SIGNER, named, valid)
    if leaf not in known:
        check_authority(leaf, others, known, named, source)
    return CheckedDocument(signed, Trust.TRUSTED, named, valid)


def _check_size(signature: etree._Element, source: str) -> None:
    """Raise InputError if a signature has so many references that the document would be digested many times."""
    for name, most in (("Reference", _MOST_REFERENCES), ("Transform", _MOST_TRANSFORMS)):
        count = sum(1 for _ in signature.iter(f"{{{DS}}}{name}"))
        if count > most:
            raise InputError(
                f"the signature has {count} elements {name}, and at most {most} are checked",
                hint="ask the laboratory for the certificate with its own signature alone",
                file=source,
            )


def _verified(
    content: bytes, embedded: Sequence[x509.Certificate], source: str
) -> tuple[x509.Certificate, list[x509.Certificate], list[VerifyResult]]:
    """Return the embedded certificate with whose key the signature was made, the others, and what the signature covers.
    The time of validity does not matter here: the document was signed earlier."""
    told = ""
    for leaf in embedded:
        begin = leaf.not_valid_before_utc
        config = SignatureConfiguration(location="./", expect_references=False, verification_time=begin)
        try:
            found = XMLVerifier().verify(content, x509_cert=leaf, expect_config=config)
        except _FAILURES as error:
            told = told or one_line(str(error) or type(error).__name__, _LONGEST_NAME)
        else:
            others = [one for one in embedded if one != leaf]
            return leaf, others, found if isinstance(found, list) else [found]
    raise InputError(
        f"the signature is not valid: {told}",
        hint="the document was changed or damaged after it was signed; ask for it again",
        file=source,
    )


def _signed_part(tag: str, found: Sequence[VerifyResult], source: str) -> bytes:
    """Return the signed text whose root element is that of the document."""
    for one in found:
        if one.signed_xml is not None and one.signed_xml.tag == tag:
            return one.signed_data
    raise InputError("the signature does not cover the whole document", file=source)


def _embedded(signature: etree._Element, source: str) -> list[x509.Certificate]:
    """Return the certificates in a signature: that of the signer, and those of authorities."""
    info = child(signature, DS, "KeyInfo")
    held = [
        one
        for data in ([] if info is None else children(info, DS, "X509Data"))
        for one in children(data, DS, "X509Certificate")
    ]
    if not held:
        raise InputError("the signature has no certificate of its signer", file=source)
    if len(held) > _MOST_CERTIFICATES:
        raise InputError(
            f"the signature has {len(held)} certificates, at most {_MOST_CERTIFICATES} are read", file=source
        )
    bodies = ["".join((one.text or "").split()) for one in held]
    try:
        return [
            certificate
            for body in bodies
            for certificate in _read_pem(
                f"-----BEGIN CERTIFICATE-----\n{body}\n-----END CERTIFICATE-----\n".encode("ascii")
            )
        ]
    except _UNREADABLE as error:
        told = one_line(str(error), _LONGEST_NAME)
        raise InputError(f"the certificate of the signer cannot be read: {told}", file=source) from None


def _read_pem(content: bytes) -> list[x509.Certificate]:
    """Return the certificates in PEM form. Raises one of `_UNREADABLE` if there is none, or if one has names or a
    validity that cannot be read: the library looks into these fields only when they are asked for. It warns of some
    that RFC 5280 does not allow, such as a serial number of 0, which are errors here."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        certificates = x509.load_pem_x509_certificates(content)
        for certificate in certificates:
            for name in (certificate.subject, certificate.issuer):
                name.rfc4514_string()
            _ = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return certificates


def _certificates(path: Path) -> list[x509.Certificate]:
    try:
        return _read_pem(path.read_bytes())
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror or error}", file=str(path)) from None
    except _UNREADABLE:
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
