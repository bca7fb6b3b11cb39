"""A signature is checked against what was signed, and against who signed it."""

from __future__ import annotations

import base64
import datetime
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID
from lxml import etree
from signers import NOW, Identity, identity
from signxml.algorithms import SignatureMethod
from signxml.signer import XMLSigner
from signxml.xades import XAdESSigner

from agent.certificates import xml_signature
from agent.certificates.xml_signature import Signer, Trust, check_signature
from drivers.errors import ConfigurationError, InputError
from twin.formats.digital_certificate.xml_reading import DS

TEXT = b'<c:doc xmlns:c="urn:c"><c:value>1.5</c:value></c:doc>'
AUTHORITY = identity("Authority", authority=True)
LABORATORY = identity("Laboratory", AUTHORITY)
STRANGER = identity("Stranger")


EARLY = datetime.datetime(2021, 6, 1, tzinfo=datetime.UTC)


def signed_by(who: Identity, folder: Path, text: bytes = TEXT, now: datetime.datetime = NOW) -> bytes:
    key, certificate = folder / "key.pem", folder / "cert.pem"
    key.write_bytes(who.key_pem)
    certificate.write_bytes(who.pem)
    return etree.tostring(Signer.read(key, certificate, now).signed(etree.fromstring(text)))


def pem(who: Identity, folder: Path) -> Path:
    path = folder / f"{who.certificate.serial_number}.pem"
    path.write_bytes(who.pem)
    return path


@pytest.mark.parametrize("who", [LABORATORY, identity("Rsa", key=rsa.generate_private_key(65537, 2048))])
def test_a_signature_of_a_known_signer_is_trusted(who: Identity, tmp_path: Path) -> None:
    signed = signed_by(who, tmp_path)
    found = check_signature(signed, "d.xml", [pem(STRANGER, tmp_path), pem(who, tmp_path)])
    assert found.trust is Trust.TRUSTED
    assert "CN=" in found.signer
    assert etree.fromstring(found.content).findtext("{urn:c}value") == "1.5"


def test_a_signer_is_trusted_by_its_authority(tmp_path: Path) -> None:
    signed = signed_by(LABORATORY, tmp_path)
    assert check_signature(signed, "d.xml", [pem(AUTHORITY, tmp_path)]).trust is Trust.TRUSTED


def test_others_are_not_trusted_and_it_is_said(tmp_path: Path) -> None:
    signed = signed_by(STRANGER, tmp_path)
    assert check_signature(signed, "d.xml").trust is Trust.UNKNOWN_SIGNER
    for known in (AUTHORITY, LABORATORY):
        with pytest.raises(InputError, match="the signer is not trusted: CN=Stranger"):
            check_signature(signed, "d.xml", [pem(known, tmp_path)])
    assert check_signature(TEXT, "d.xml").trust is Trust.UNSIGNED
    with pytest.raises(InputError, match="the document is not signed"):
        check_signature(TEXT, "d.xml", [pem(LABORATORY, tmp_path)])


def test_a_certificate_that_has_expired_since_is_trusted_if_it_is_the_signers_own(tmp_path: Path) -> None:
    once = identity("Once", AUTHORITY, until=datetime.datetime(2026, 7, 1, tzinfo=datetime.UTC))
    signed = signed_by(once, tmp_path)
    assert check_signature(signed, "d.xml", [pem(once, tmp_path)]).trust is Trust.TRUSTED


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"1.5", b"1.6"),
        (b"<c:value>", b"<c:value/><c:value>"),
        (b"</c:value>", b"</c:value>more"),
        (b"SignatureValue>", b"SignatureValue>AAAA"),
        (b"xmldsig-more#ecdsa-sha256", b"xmldsig-more#ecdsa-sha1"),
        (b"SignedInfo>", b"Signed>"),
        (b'URI=""', b'URI="#a"'),
        (b'URI=""', b'URI="file:///etc/passwd"'),
        (b"X509Certificate>", b"X509Certificate>!"),
        (b"X509Certificate>", b"X509CRL>"),
    ],
)
def test_what_was_changed_is_refused_whoever_is_trusted(old: bytes, new: bytes, tmp_path: Path) -> None:
    signed = signed_by(LABORATORY, tmp_path)
    assert old in signed
    for trusted in ([], [pem(LABORATORY, tmp_path)]):
        with pytest.raises(InputError) as caught:
            check_signature(signed.replace(old, new), "d.xml", trusted)
        assert caught.value.where["file"] == "d.xml"


VERSION_3, VERSION_45 = b"\xa0\x03\x02\x01\x02", b"\xa0\x03\x02\x01\x2c"
"""Version of a certificate in DER (RFC 5280, 4.1.2.1), which is its number less one."""


def negative_serial_number(der: bytes) -> bytes:
    """The serial number follows on the version."""
    length_at = der.index(VERSION_3) + len(VERSION_3) + 1
    return der[: length_at + 1] + b"\xff" + der[length_at + 2 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda der: der.replace(b"Laboratory", b"Laborator\xff"),
        lambda der: der.replace(b"\x0c\x0aLaboratory", b"\x03\x0a\x00aboratory"),
        lambda der: der.replace(VERSION_3, VERSION_45),
        negative_serial_number,
    ],
    ids=["name", "bits for a name", "version", "serial number"],
)
def test_a_certificate_that_cannot_be_read_is_refused(damage: Callable[[bytes], bytes], tmp_path: Path) -> None:
    """Its key still belongs to the signature, which does not cover it."""
    signed = etree.fromstring(signed_by(LABORATORY, tmp_path))
    damaged = damage(LABORATORY.certificate.public_bytes(Encoding.DER))
    held = signed.find(f".//{{{DS}}}X509Certificate")
    assert held is not None
    held.text = base64.b64encode(damaged).decode("ascii")
    with pytest.raises(InputError, match="the certificate of the signer cannot be read") as caught:
        check_signature(etree.tostring(signed), "d.xml")
    assert caught.value.where["file"] == "d.xml"


def test_a_file_of_signers_whose_name_is_no_text_is_refused(tmp_path: Path) -> None:
    damaged = LABORATORY.certificate.public_bytes(Encoding.DER).replace(b"Laboratory", b"Laborator\xff")
    path = tmp_path / "damaged.pem"
    body = base64.encodebytes(damaged).decode("ascii")
    path.write_text(f"-----BEGIN CERTIFICATE-----\n{body}-----END CERTIFICATE-----\n", encoding="ascii")
    with pytest.raises(InputError, match="no certificate") as caught:
        check_signature(signed_by(LABORATORY, tmp_path), "d.xml", [path])
    assert caught.value.where["file"] == str(path)


def test_a_comment_does_not_hide_a_part_of_what_was_signed(tmp_path: Path) -> None:
    """Comments are not signed, but split a text for many readers."""
    signed = signed_by(LABORATORY, tmp_path)
    found = check_signature(signed.replace(b"1.5", b"1<!-- -->.5"), "d.xml", [pem(LABORATORY, tmp_path)])
    assert etree.fromstring(found.content).findtext("{urn:c}value") == "1.5"


def test_a_part_that_was_signed_does_not_vouch_for_the_whole(tmp_path: Path) -> None:
    """A signed document inside of another one, whose signature is moved to the outer one."""
    inner = etree.fromstring(signed_by(LABORATORY, tmp_path, b'<c:part xmlns:c="urn:c" Id="a">1</c:part>'))
    outer = etree.fromstring(TEXT)
    signature = inner[-1]
    outer.append(inner)
    outer.append(signature)
    for trusted in ([], [pem(LABORATORY, tmp_path)]):
        with pytest.raises(InputError):
            check_signature(etree.tostring(outer), "d.xml", trusted)


def test_a_signature_that_also_covers_its_own_properties_is_checked(tmp_path: Path) -> None:
    """XAdES, as seals of laboratories are made: two references, of which one is the document."""
    signer = XAdESSigner(signature_algorithm=SignatureMethod.ECDSA_SHA256)
    cert = STRANGER.pem.decode("ascii")
    signed = etree.tostring(signer.sign(etree.fromstring(TEXT), key=STRANGER.key_pem, cert=cert))
    found = check_signature(signed, "d.xml", [pem(STRANGER, tmp_path)])
    assert found.trust is Trust.TRUSTED
    assert etree.fromstring(found.content).findtext("{urn:c}value") == "1.5"
    for old, new in ((b">1.5<", b">1.6<"), (b"SigningTime>20", b"SigningTime>19")):
        assert old in signed
        with pytest.raises(InputError, match="the signature is not valid"):
            check_signature(signed.replace(old, new), "d.xml")


def test_several_signatures_are_refused(tmp_path: Path) -> None:
    signed = etree.fromstring(signed_by(LABORATORY, tmp_path))
    signed.append(etree.fromstring(etree.tostring(signed[-1])))
    with pytest.raises(InputError, match="2 signatures"):
        check_signature(etree.tostring(signed), "d.xml")


def test_a_signer_that_cannot_sign_is_refused(tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    key.write_bytes(LABORATORY.key_pem)
    certificate.write_bytes(STRANGER.pem)
    with pytest.raises(ConfigurationError, match="not that of the key"):
        Signer.read(key, certificate, NOW)
    certificate.write_bytes(LABORATORY.pem)
    with pytest.raises(ConfigurationError, match="is valid from 2020-01-01"):
        Signer.read(key, certificate, NOW + datetime.timedelta(days=40_000))
    with pytest.raises(ConfigurationError, match="no certificate in PEM form"):
        Signer.read(key, key, NOW)
    with pytest.raises(ConfigurationError, match="No such file"):
        Signer.read(tmp_path / "absent.pem", certificate, NOW)
    for content, told in (
        (LABORATORY.pem, "no private key in PEM form"),
        (
            LABORATORY.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x")),
            "encrypted with a passphrase",
        ),
    ):
        key.write_bytes(content)
        with pytest.raises(ConfigurationError, match=told):
            Signer.read(key, certificate, NOW)


def test_a_key_of_another_kind_is_refused(tmp_path: Path) -> None:
    key = tmp_path / "key.pem"
    made = ed25519.Ed25519PrivateKey.generate()
    key.write_bytes(made.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    with pytest.raises(ConfigurationError, match="of a kind that does not sign XML"):
        Signer.read(key, pem(LABORATORY, tmp_path), NOW)


def test_an_authority_vouches_for_a_certificate_that_has_expired_since(tmp_path: Path) -> None:
    once = identity("Once", AUTHORITY, until=datetime.datetime(2021, 7, 1, tzinfo=datetime.UTC))
    found = check_signature(signed_by(once, tmp_path, now=EARLY), "d.xml", [pem(AUTHORITY, tmp_path)])
    assert (found.trust, found.valid) == (Trust.TRUSTED, (datetime.date(2020, 1, 1), datetime.date(2021, 7, 1)))
    old = identity("Old authority", authority=True, until=datetime.datetime(2021, 7, 1, tzinfo=datetime.UTC))
    with pytest.raises(InputError, match="the authority is not valid today"):
        check_signature(signed_by(identity("L", old), tmp_path), "d.xml", [pem(old, tmp_path)])


def test_the_certificate_of_the_signer_may_stand_behind_that_of_its_authority(tmp_path: Path) -> None:
    signer = XMLSigner(signature_algorithm=SignatureMethod.ECDSA_SHA256)
    chain = [AUTHORITY.certificate, LABORATORY.certificate]
    signed = etree.tostring(signer.sign(etree.fromstring(TEXT), key=LABORATORY.key, cert=chain))
    for trusted in (LABORATORY, AUTHORITY):
        found = check_signature(signed, "d.xml", [pem(trusted, tmp_path)])
        assert (found.trust, "CN=Laboratory" in found.signer) == (Trust.TRUSTED, True)


@pytest.mark.parametrize(
    ("usage", "purposes", "told"),
    [
        ({"content_commitment": True}, [], ""),
        ({"digital_signature": True}, [ExtendedKeyUsageOID.EMAIL_PROTECTION], ""),
        ({"key_encipherment": True}, [], "not one that signs"),
        ({"digital_signature": True}, [ExtendedKeyUsageOID.SERVER_AUTH], "one of a web site"),
    ],
)
def test_the_rules_for_signers_are_those_of_seals(
    usage: dict[str, bool], purposes: list[x509.ObjectIdentifier], told: str, tmp_path: Path
) -> None:
    """A seal has no name of a host, and its key may be one that commits to contents."""
    signed = signed_by(seal(usage, purposes), tmp_path)
    if not told:
        assert check_signature(signed, "d.xml", [pem(AUTHORITY, tmp_path)]).trust is Trust.TRUSTED
        return
    with pytest.raises(InputError, match="the signer is not trusted: CN=Seal") as caught:
        check_signature(signed, "d.xml", [pem(AUTHORITY, tmp_path)])
    assert told in caught.value.hint


def test_a_signer_cannot_certify_others(tmp_path: Path) -> None:
    forged = identity("Forged", LABORATORY)
    signer = Signer(forged.key, (forged.certificate, LABORATORY.certificate))
    signed = etree.tostring(signer.signed(etree.fromstring(TEXT)))
    for trusted in (AUTHORITY, LABORATORY):
        with pytest.raises(InputError, match="the signer is not trusted: CN=Forged"):
            check_signature(signed, "d.xml", [pem(trusted, tmp_path)])


def seal(usage: dict[str, bool], purposes: list[x509.ObjectIdentifier]) -> Identity:
    """Return an identity certified by AUTHORITY without the name of a host."""
    key = ec.generate_private_key(ec.SECP256R1())
    names = (
        *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
        *("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"),
    )
    built = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "Seal")]))
        .issuer_name(AUTHORITY.certificate.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC))
        .not_valid_after(datetime.datetime(2120, 1, 1, tzinfo=datetime.UTC))
        .add_extension(x509.KeyUsage(**{name: usage.get(name, False) for name in names}), critical=True)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(AUTHORITY.key.public_key()), critical=False)
    )
    if purposes:
        built = built.add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
    return Identity(key, built.sign(AUTHORITY.key, SHA256()))


@pytest.mark.parametrize("name", ["Reference", "Transform"])
def test_a_signature_with_many_references_is_refused_before_it_is_digested(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    signed = etree.fromstring(signed_by(LABORATORY, tmp_path))
    (one, *_) = signed.iter(f"{{{DS}}}{name}")
    for _ in range(20):
        one.addnext(etree.fromstring(etree.tostring(one)))
    monkeypatch.setattr(xml_signature, "_verified", lambda *_: pytest.fail("was digested"))
    with pytest.raises(InputError, match=f"2[012] elements {name}"):
        check_signature(etree.tostring(signed), "d.xml")
