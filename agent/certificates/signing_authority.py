"""Authorities that certify the signers of documents.

The rules are those of signatures and seals, not of web sites: the certificate of a signer needs no name of a host, and
its key must be one that signs.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from typing import Final

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from cryptography.x509.verification import (
    Criticality,
    ExtensionPolicy,
    Policy,
    PolicyBuilder,
    Store,
    VerificationError,
)

from agent.printable import one_line
from drivers.clock import utc_timestamp
from drivers.errors import InputError

_LONGEST: Final = 120
_WEB: Final = {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}


def check_authority(
    leaf: x509.Certificate,
    others: Sequence[x509.Certificate],
    known: Sequence[x509.Certificate],
    named: str,
    source: str,
) -> None:
    """Raise InputError unless one of the `known` certificates is that of an authority that certifies the signer `leaf`,
    directly or by way of some of the `others`. `named` is the name of the signer.

    The authority must be valid today. The certificate of the signer may have expired: the path must then have been
    valid on its last day.
    """
    now = datetime.datetime.fromisoformat(utc_timestamp())
    valid = [one for one in known if one.not_valid_before_utc <= now <= one.not_valid_after_utc]
    told = "the authority is not valid today" if known else ""
    if valid:
        at = max(leaf.not_valid_before_utc, min(now, leaf.not_valid_after_utc))
        builder = PolicyBuilder().store(Store(valid)).time(at)
        rules = builder.extension_policies(ca_policy=ExtensionPolicy.webpki_defaults_ca(), ee_policy=_signer_policy())
        try:
            rules.build_client_verifier().verify(leaf, list(others))
        except (VerificationError, ValueError) as error:
            told = one_line(str(error), _LONGEST)
        else:
            return
    raise InputError(
        f"the signer is not trusted: {named}",
        hint=f"pass the certificate of the signer or of its authority with --trusted ({told})",
        file=source,
    )


def _signer_policy() -> ExtensionPolicy:
    """Return the rules for the certificate of a signer: what it may be used for, if it states that."""
    return (
        ExtensionPolicy.permit_all()
        .may_be_present(x509.KeyUsage, Criticality.AGNOSTIC, _check_key_usage)
        .may_be_present(x509.ExtendedKeyUsage, Criticality.AGNOSTIC, _check_purposes)
        .may_be_present(x509.BasicConstraints, Criticality.AGNOSTIC, _check_is_no_authority)
    )


def _check_key_usage(_: Policy, __: x509.Certificate, usage: x509.KeyUsage | None) -> None:
    if usage is not None and not (usage.digital_signature or usage.content_commitment):
        raise ValueError("the key of the signer is not one that signs")


def _check_purposes(_: Policy, __: x509.Certificate, purposes: x509.ExtendedKeyUsage | None) -> None:
    if purposes is not None and set(purposes) <= _WEB:
        raise ValueError("the certificate of the signer is one of a web site")


def _check_is_no_authority(_: Policy, __: x509.Certificate, constraints: x509.BasicConstraints | None) -> None:
    if constraints is not None and constraints.ca:
        raise ValueError("the certificate of the signer is one of an authority")
