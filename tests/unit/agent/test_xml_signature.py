"""A signature is checked against what was signed, and against who signed it."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ed25519, rsa
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, NoEncryption, PrivateFormat
from lxml import etree
from signers import NOW, Identity, identity
from signxml.algorithms import SignatureMethod
from signxml.xades import XAdESSigner

from agent.certificates.xml_signature import Signer, Trust, check_signature
from drivers.errors import ConfigurationError, InputError

TEXT = b'<c:doc xmlns:c="urn:c"><c:value>1.5</c:value></c:doc>'
AUTHORITY = identity("Authority", authority=True)
LABORATORY = identity("Laboratory", AUTHORITY)
STRANGER = identity("Stranger")


def signed_by(who: Identity, folder: Path, text: bytes = TEXT) -> bytes:
    key, certificate = folder / "key.pem", folder / "cert.pem"
    key.write_bytes(who.key_pem)
    certificate.write_bytes(who.pem)
    return etree.tostring(Signer.read(key, certificate, NOW).signed(etree.fromstring(text)))


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
