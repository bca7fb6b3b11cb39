"""Digital calibration certificates of an artefact, written by hand from the documentation of the schema."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si" schemaVersion="3.3.0">
<dcc:administrativeData>
<dcc:dccSoftware><dcc:software><dcc:name><dcc:content>laboratory</dcc:content></dcc:name>
<dcc:release>1</dcc:release></dcc:software></dcc:dccSoftware>
<dcc:coreData><dcc:countryCodeISO3166_1>DE</dcc:countryCodeISO3166_1>
<dcc:usedLangCodeISO639_1>de</dcc:usedLangCodeISO639_1><dcc:mandatoryLangCodeISO639_1>de</dcc:mandatoryLangCodeISO639_1>
<dcc:uniqueIdentifier>D-K-1 2014-05</dcc:uniqueIdentifier>
<dcc:beginPerformanceDate>2014-02-27</dcc:beginPerformanceDate>
<dcc:endPerformanceDate>2014-03-01</dcc:endPerformanceDate>
<dcc:performanceLocation>laboratory</dcc:performanceLocation></dcc:coreData>
<dcc:items><dcc:item><dcc:name>
<dcc:content lang="de">Kugelstab</dcc:content><dcc:content lang="en">ball bar</dcc:content>
</dcc:name><dcc:manufacturer><dcc:name><dcc:content>Maker</dcc:content></dcc:name></dcc:manufacturer>
<dcc:model>B5</dcc:model><dcc:identifications>
<dcc:identification><dcc:issuer>customer</dcc:issuer><dcc:value>inventory 7</dcc:value></dcc:identification>
<dcc:identification><dcc:issuer>manufacturer</dcc:issuer><dcc:value>SN 42</dcc:value></dcc:identification>
</dcc:identifications></dcc:item></dcc:items>
<dcc:calibrationLaboratory><dcc:contact><dcc:name><dcc:content>Laboratory</dcc:content></dcc:name>
<dcc:location><dcc:city>Braunschweig</dcc:city></dcc:location></dcc:contact></dcc:calibrationLaboratory>
<dcc:respPersons><dcc:respPerson><dcc:person><dcc:name><dcc:content>A. B.</dcc:content></dcc:name></dcc:person>
</dcc:respPerson></dcc:respPersons>
<dcc:customer><dcc:name><dcc:content>Customer</dcc:content></dcc:name><dcc:location><dcc:city>X</dcc:city></dcc:location>
</dcc:customer>
<dcc:statements><dcc:statement refType="basic_validUntil"><dcc:date>2126-03-01</dcc:date>
</dcc:statement></dcc:statements>
</dcc:administrativeData>
<dcc:measurementResults><dcc:measurementResult>
<dcc:name><dcc:content>Results</dcc:content></dcc:name><dcc:results>
"""
TAIL = """</dcc:results></dcc:measurementResult></dcc:measurementResults></dcc:digitalCalibrationCertificate>
"""


def certificate(*results: str) -> bytes:
    """Return a certificate with the results, each of which has its quantities as text."""
    named = (
        f"<dcc:result><dcc:name><dcc:content>Result {number}</dcc:content></dcc:name>"
        f"<dcc:data>{text}</dcc:data></dcc:result>"
        for number, text in enumerate(results, start=1)
    )
    return f"{HEAD}{''.join(named)}{TAIL}".encode()


def words(values: NDArray[np.float64] | Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def quantity(role: str, inner: str) -> str:
    return f'<dcc:quantity refType="volcal_{role}">{inner}</dcc:quantity>'


def centres_with_covariance(balls: NDArray[np.float64], covariance: NDArray[np.float64]) -> str:
    """Return a quantity with centres in m and their covariance in µm², both given in mm."""
    columns = "".join(
        "<si:columnXMLList><si:covarianceXMLList>"
        f"<si:valueXMLList>{words(1e6 * column)}</si:valueXMLList>"
        r"<si:unitXMLList>\micro\metre\tothe{2}</si:unitXMLList></si:covarianceXMLList></si:columnXMLList>"
        for column in covariance.T
    )
    return quantity(
        "ballCentres",
        f"<si:realListXMLList><si:valueXMLList>{words(balls / 1e3)}</si:valueXMLList>"
        r"<si:unitXMLList>\metre</si:unitXMLList>"
        "<si:measurementUncertaintyMultivariateXMLList><si:ellipsoidalRegionMUXMLList>"
        f"<si:covarianceMatrixXMLList>{columns}</si:covarianceMatrixXMLList>"
        "<si:coverageFactorXMLList>2</si:coverageFactorXMLList>"
        "<si:coverageProbabilityXMLList>0.95</si:coverageProbabilityXMLList>"
        "</si:ellipsoidalRegionMUXMLList></si:measurementUncertaintyMultivariateXMLList></si:realListXMLList>",
    )


def expanded_list(role: str, values_mm: NDArray[np.float64] | Sequence[float], expanded_um: float) -> str:
    """Return a quantity with lengths in mm and one expanded uncertainty (k = 2) for all of them, given in µm."""
    return quantity(
        role,
        f"<si:realListXMLList><si:valueXMLList>{words(values_mm)}</si:valueXMLList>"
        r"<si:unitXMLList>\milli\metre</si:unitXMLList>"
        "<si:measurementUncertaintyUnivariateXMLList><si:expandedMUXMLList>"
        f"<si:valueExpandedMUXMLList>{expanded_um / 1e3!r}</si:valueExpandedMUXMLList>"
        "<si:coverageFactorXMLList>2</si:coverageFactorXMLList>"
        "<si:coverageProbabilityXMLList>0.95</si:coverageProbabilityXMLList>"
        "</si:expandedMUXMLList></si:measurementUncertaintyUnivariateXMLList></si:realListXMLList>",
    )


def real(role: str, value: float, unit: str, doubt: str = "") -> str:
    return quantity(role, f"<si:real><si:value>{value!r}</si:value><si:unit>{unit}</si:unit>{doubt}</si:real>")
