"""Decoders of digital calibration certificates (XML): their content and their signature."""

from __future__ import annotations

import datetime
from collections.abc import Iterator

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from lxml import etree

from agent.certificates.xml_signature import Signer, check_signature
from campaigns.fuzz.trial import Decoder
from twin.formats.digital_certificate.certificate import parse_certificate

_COLUMNS = "".join(
    "<si:columnXMLList><si:covarianceXMLList><si:valueXMLList>"
    + " ".join("0.25" if row == column else "0" for row in range(6))
    + r"</si:valueXMLList><si:unitXMLList>\micro\metre\tothe{2}</si:unitXMLList>"
    "</si:covarianceXMLList></si:columnXMLList>"
    for column in range(6)
)
CERTIFICATE = rf"""<?xml version="1.0" encoding="UTF-8"?>
<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si" schemaVersion="3.3.0">
<dcc:administrativeData><dcc:coreData><dcc:uniqueIdentifier>K 1</dcc:uniqueIdentifier>
<dcc:endPerformanceDate>2026-03-01</dcc:endPerformanceDate></dcc:coreData>
<dcc:items><dcc:item><dcc:name><dcc:content lang="en">bar</dcc:content></dcc:name></dcc:item></dcc:items>
<dcc:calibrationLaboratory><dcc:contact><dcc:name><dcc:content>Laboratory</dcc:content></dcc:name></dcc:contact>
</dcc:calibrationLaboratory></dcc:administrativeData>
<dcc:measurementResults><dcc:measurementResult><dcc:results><dcc:result><dcc:data>
<dcc:quantity refType="volcal_ballCentres"><si:realListXMLList><si:valueXMLList>0 0 0 100 0 0</si:valueXMLList>
<si:unitXMLList>\milli\metre</si:unitXMLList><si:measurementUncertaintyMultivariateXMLList>
<si:ellipsoidalRegionMUXMLList><si:covarianceMatrixXMLList>{_COLUMNS}</si:covarianceMatrixXMLList>
<si:coverageFactorXMLList>2</si:coverageFactorXMLList></si:ellipsoidalRegionMUXMLList>
</si:measurementUncertaintyMultivariateXMLList></si:realListXMLList></dcc:quantity>
<dcc:quantity refType="volcal_ballDiameter"><si:hybrid><si:real><si:value>20</si:value>
<si:unit>\milli\metre</si:unit><si:expandedUnc><si:uncertainty>0.1</si:uncertainty>
<si:coverageFactor>2</si:coverageFactor></si:expandedUnc></si:real></si:hybrid></dcc:quantity>
</dcc:data></dcc:result></dcc:results></dcc:measurementResult></dcc:measurementResults>
</dcc:digitalCalibrationCertificate>
""".encode()

_UNITS = (rb"\milli\metre\tothe{1}", rb"\milli\metre\tothe{2}\per\milli\metre")


def certificate_decoders() -> Iterator[Decoder]:
    """Yield the decoders of the content of a certificate and of its signature."""
    seeds = [CERTIFICATE, *(CERTIFICATE.replace(rb"\milli\metre<", unit + b"<") for unit in _UNITS)]
    yield Decoder("certificate of an artefact (XML)", seeds, lambda data: parse_certificate(data, "dcc.xml"))
    yield Decoder("signature of a certificate (XML)", [_signed()], lambda data: check_signature(data, "dcc.xml"))


def _signed() -> bytes:
    """Return a small document with a signature."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "fuzz")])
    begin = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(begin)
        .not_valid_after(begin + datetime.timedelta(days=40_000))
        .sign(key, SHA256())
    )
    document = etree.fromstring(b'<c:doc xmlns:c="urn:c"><c:value>1.5</c:value></c:doc>')
    return etree.tostring(Signer(key, (certificate,)).signed(document))
