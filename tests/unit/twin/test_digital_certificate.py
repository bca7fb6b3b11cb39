"""Certificates written by hand give the artefact that they describe, and what is not understood is refused by name."""

from __future__ import annotations

import datetime
from dataclasses import replace

import numpy as np
import pytest
from certificate_text import centres_with_covariance, certificate, expanded_list, quantity, real, words

from twin.artefact.artefact import Artefact, ball_bar
from twin.errors import DataError, FormatError
from twin.formats.artefact_file import parse_artefact
from twin.formats.digital_certificate import xml_reading
from twin.formats.digital_certificate.certificate import parse_certificate
from twin.formats.digital_certificate.certified_artefact import certified_artefact
from twin.formats.digital_certificate.dsi_units import METRE, factor_to, parse_unit
from twin.formats.digital_certificate.xml_reading import parse_xml

TILTED = ball_bar(
    "bar",
    balls=5,
    length_mm=400.0,
    tilt_rad=0.5,
    holder_length_mm=50.0,
    ball_diameter_mm=20.0,
    standard_uncertainty_mm=1.0,
)
STRAIGHT = ball_bar("straight", balls=4, length_mm=300.0, tilt_rad=0.0, holder_length_mm=40.0, ball_diameter_mm=20.0)
DEVIATIONS = np.random.default_rng(5).normal(0.0, 0.02, (5, 3))
TURN = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])  # a rotation
AWAY = np.array([1000.0, -200.0, 30.0])


def covariance_of(count: int) -> np.ndarray:
    root = np.random.default_rng(6).normal(0.0, 3e-4, (3 * count, 3 * count))
    return root @ root.T


def test_centres_and_covariance_come_back_in_the_frame_of_the_mount() -> None:
    """The certificate is in another frame; lengths, and the uncertainty of each, are those of the laboratory."""
    true, covariance = TILTED.balls + DEVIATIONS, covariance_of(5)
    turned = np.kron(np.eye(5), TURN)
    text = certificate(centres_with_covariance(true @ TURN.T + AWAY, turned @ covariance @ turned.T))
    found = certified_artefact(parse_certificate(text, "c.xml"), TILTED, "origin")
    assert np.abs(found.balls - TILTED.balls).max() < 0.1
    for first, second in ((0, 1), (0, 4), (2, 3)):
        line, expected = found.balls[second] - found.balls[first], true[second] - true[first]
        assert np.linalg.norm(line) == pytest.approx(np.linalg.norm(expected), abs=1e-9)
        assert length_variance(found.covariance, first, second, line) == pytest.approx(
            length_variance(covariance, first, second, expected), rel=1e-6
        )
    assert (found.certificate, found.sag_mm, found.cte_per_k) == ("origin", TILTED.sag_mm, TILTED.cte_per_k)


def length_variance(covariance: np.ndarray, first: int, second: int, line: np.ndarray) -> float:
    gradient = np.zeros(len(covariance))
    unit = line / np.linalg.norm(line)
    gradient[3 * second : 3 * second + 3], gradient[3 * first : 3 * first + 3] = unit, -unit
    return float(gradient @ covariance @ gradient)


def test_single_coordinates_are_read_ball_by_ball() -> None:
    balls = TILTED.balls
    lists = [expanded_list(f"ballCentre{name}", balls[:, axis], 1.2) for axis, name in enumerate("XYZ")]
    found = parse_certificate(certificate("".join(lists)), "c.xml")
    assert found.centres == pytest.approx(balls)
    assert found.covariance == pytest.approx(np.eye(15) * 0.6e-3**2)
    # one si:real for each coordinate, told by its name alone
    reals = "".join(
        f"<dcc:list><dcc:name><dcc:content>Kugel {number}</dcc:content></dcc:name>"
        + "".join(
            f"<dcc:quantity><dcc:name><dcc:content lang='de'>Koordinate {name}</dcc:content></dcc:name>"
            rf"<si:real><si:value>{1e3 * value!r}</si:value><si:unit>\micro\metre</si:unit><si:expandedUnc>"
            "<si:uncertainty>1.2</si:uncertainty><si:coverageFactor>2</si:coverageFactor>"
            "<si:coverageProbability>0.95</si:coverageProbability></si:expandedUnc></si:real></dcc:quantity>"
            for name, value in zip("XYZ", ball.tolist(), strict=True)
        )
        + "</dcc:list>"
        for number, ball in enumerate(balls)
    )
    again = parse_certificate(certificate(reals), "c.xml")
    assert again.centres == pytest.approx(balls)
    assert again.covariance == pytest.approx(np.eye(15) * 0.6e-3**2)


def test_a_straight_bar_keeps_the_roll_of_its_certificate() -> None:
    true = STRAIGHT.balls + np.random.default_rng(7).normal(0.0, 0.003, (4, 3))
    text = certificate(centres_with_covariance(true + AWAY, covariance_of(4)))
    found = certified_artefact(parse_certificate(text, "c.xml"), STRAIGHT, "origin")
    assert found.balls == pytest.approx(true, abs=0.02)
    assert found.balls[:, 2] - found.balls[:, 2].mean() == pytest.approx(true[:, 2] - true[:, 2].mean(), abs=2e-3)


def test_distances_are_joined_to_the_nominal_centres() -> None:
    lengths = np.linalg.norm(TILTED.balls[1:] - TILTED.balls[0], axis=1) + np.array([0.01, -0.02, 0.03, 0.04])
    known = replace(TILTED, uncertified=(2,))
    for stated in (lengths, np.concatenate(([0.0], lengths))):
        found = parse_certificate(certificate(expanded_list("ballDistances", stated, 2.0)), "c.xml")
        moved = certified_artefact(found, known, "origin")
        assert np.linalg.norm(moved.balls[1:] - moved.balls[0], axis=1) == pytest.approx(lengths, abs=2e-3)
        assert moved.uncertified == (2,)
    with pytest.raises(DataError, match="of 4 balls, the artefact 'bar' has 5"):
        certified_artefact(
            parse_certificate(certificate(expanded_list("ballDistances", lengths[:3], 2.0)), "c"), known, ""
        )


def test_what_else_a_certificate_states_is_taken_over() -> None:
    doubt = (
        "<si:measurementUncertaintyUnivariate><si:standardMU><si:valueStandardMU>0.2</si:valueStandardMU></si:standardMU>"
        "</si:measurementUncertaintyUnivariate>"
    )
    text = certificate(
        centres_with_covariance(TILTED.balls, covariance_of(5)),
        expanded_list("ballDiameter", [20.001, 20.003, 20.002, 20.002, 20.002], 0.5)
        + real("thermalExpansionCoefficient", 11.9, r"\micro\metre\per\metre\per\kelvin", doubt)
        + real("referenceTemperature", 293.15, r"\kelvin"),
    )
    found = parse_certificate(text, "c.xml")
    assert found.ball_diameter_mm == pytest.approx(20.002)
    assert found.expansion == pytest.approx((11.9e-6, 0.2e-6))
    assert found.reference_temperature_c == pytest.approx(20.0)
    identity = found.identity
    assert (identity.number, identity.laboratory, identity.serial_number) == ("D-K-1 2014-05", "Laboratory", "SN 42")
    assert (identity.item, identity.manufacturer, identity.model) == ("ball bar", "Maker", "B5")
    assert (identity.performed, identity.until) == (datetime.date(2014, 3, 1), datetime.date(2126, 3, 1))
    assert "Laboratory D-K-1 2014-05, serial number SN 42, calibrated on 2014-03-01" in identity.text


GOOD = certificate(centres_with_covariance(TILTED.balls, covariance_of(5))).decode()
SINGLE = certificate(
    "".join(expanded_list(f"ballCentre{name}", TILTED.balls[:, axis], 1.2) for axis, name in enumerate("XYZ"))
).decode()
FORM = real("roundness", 0.1, r"\micro\metre")


@pytest.mark.parametrize(
    ("text", "old", "new", "told"),
    [
        (GOOD, "digitalCalibrationCertificate", "somethingElse", "this is no digital calibration certificate"),
        (GOOD, 'schemaVersion="3.3.0"', 'schemaVersion="2.4.0"', "schema version '2.4.0'"),
        (GOOD, "https://ptb.de/si", "https://example.org/si", "realListXMLList of a quantity is not understood"),
        (GOOD, r"<si:unitXMLList>\metre<", r"<si:unitXMLList>\second<", r"the unit '\\second' is not known"),
        (GOOD, r"<si:unitXMLList>\metre<", r"<si:unitXMLList>\kelvin<", "does not measure what is stated here"),
        (
            GOOD,
            r"\micro\metre\tothe{2}",
            r"\micro\metre",
            r"covarianceMatrixXMLList/columnXMLList\[1\]/covarianceXMLList",
        ),
        (GOOD, "ballCentres", "ballMiddles", "the quantity 'volcal_ballMiddles' is not understood"),
        (GOOD, "<dcc:data>", "<dcc:data><dcc:formula/>", "the element formula of a result is not understood"),
        (GOOD, "<dcc:data>", f"<dcc:data>{FORM}", "'volcal_roundness' is not understood"),
        (GOOD, "<si:coverageFactorXMLList>2", "<si:coverageFactorXMLList>2", ""),
        (GOOD, "2014-03-01</dcc:end", "spring</dcc:end", "'spring' is not a date"),
        (GOOD, "<dcc:uniqueIdentifier>D-K-1 2014-05", "<dcc:uniqueIdentifier> ", "the certificate has no number"),
        (GOOD, "</dcc:item>", "</dcc:item><dcc:item/>", "of 2 items, and not of one"),
        (GOOD, "covarianceMatrixXMLList>", "correlationMatrix>", "has no covariance matrix"),
        (
            SINGLE,
            "measurementUncertaintyUnivariateXMLList",
            "doubt",
            "the element doubt of a quantity is not understood",
        ),
        (SINGLE, "expandedMUXMLList", "guess", "the uncertainty 'guess' is not understood"),
        (SINGLE, "<si:coverageFactorXMLList>2", "<si:coverageFactorXMLList>0.5", "a coverage factor is less than 1"),
        (SINGLE, "ballCentreZ", "ballCentreX", "the numbers of X, Y and Z coordinates differ"),
        (SINGLE, ">0.0012<", ">-0.0012<", "an uncertainty is negative"),
        (SINGLE, ">0.0012<", ">NaN<", "'NaN' is not a finite number"),
        (SINGLE, ">0.0012<", ">1e999<", "'1e999' is not a finite number"),
        (SINGLE, ">0.0012<", f">{'9' * 300_000}<", "9' is not a finite number"),  # an hour, if searched for its point
        (GOOD, r"<si:unitXMLList>\metre<", r"<si:unitXMLList>\pico\metre\tothe{-99}<", "is not known"),
        (GOOD, r"<si:unitXMLList>\metre<", r"<si:unitXMLList>\kilo\metre<", "a length is larger than 100 m"),
        (GOOD, r"\micro\metre\tothe{2}", r"\milli\metre\tothe{2}", "a standard uncertainty is .* mm"),
        (SINGLE, ">0.0012<", ">0.0<", "a standard uncertainty is 0"),
        (SINGLE, ">0.0012<", ">1e200<", "a number is too large|a standard uncertainty is"),
        (SINGLE, "<si:coverageFactorXMLList>2", "<si:coverageFactorXMLList>100", "a coverage factor is larger than 10"),
        (
            SINGLE,
            "<si:coverageFactorXMLList>2",
            "<si:coverageFactorXMLList>1",
            "factor 1 contradicts the coverage prob",
        ),
        (SINGLE, "ProbabilityXMLList>0.95", "ProbabilityXMLList>7", "a coverage probability is not between 0 and 1"),
        (
            SINGLE,
            "0.95</si:coverageProbabilityXMLList>",
            "0.95</si:coverageProbabilityXMLList><si:distributionXMLList>rectangular</si:distributionXMLList>",
            "factor 2 contradicts the coverage probability 0.95",
        ),
        (SINGLE, "</si:valueXMLList>", "<x/>9 9</si:valueXMLList>", "only numbers are expected here"),
        (SINGLE, "<si:unitXMLList>", "9 9<si:unitXMLList>", "the text '9 9' is not expected here"),
        (SINGLE, "</si:realListXMLList>", "</si:realListXMLList><si:real/>", "the quantity states its value twice"),
        (SINGLE, "<si:unitXMLList>", "<si:unitXMLList/><si:unitXMLList>", "unitXMLList of a quantity is stated twice"),
        (SINGLE, "</si:realListXMLList>", "</si:realListXMLList><dcc:other/>", "element other of a quantity is not"),
        (GOOD, 'refType="', 'refType="basic_nominalValue ', "is a 'basic_nominalValue', and not what was measured"),
        (GOOD, "2014-03-01</dcc:end", "2014-03-01garbage</dcc:end", "'2014-03-01garbage' is not a date"),
        (GOOD, "2014-03-01</dcc:end", "2014-W09-6</dcc:end", "'2014-W09-6' is not a date"),
        (GOOD, "<dcc:date>2126-03-01</dcc:date>", "", "neither a date nor a period"),
        (GOOD, "<dcc:date>2126-03-01</dcc:date>", "<dcc:period>PT5H</dcc:period>", "'PT5H' is not a period"),
        (SINGLE, "</si:realListXMLList>", "</si:realListXMLList><dcc:relativeUncertainty/>", "a relative uncertainty"),
    ],
)
def test_what_is_not_understood_is_refused_by_name(text: str, old: str, new: str, told: str) -> None:
    assert old in text
    if not told:
        parse_certificate(text.encode(), "c.xml")
        return
    with pytest.raises(FormatError, match=told) as caught:
        parse_certificate(text.replace(old, new).encode(), "c.xml")
    assert caught.value.where["file"] == "c.xml"
    assert caught.value.where["element"].startswith("/")


STANDARD = (
    "<si:measurementUncertaintyUnivariate><si:standardMU><si:valueStandardMU>{}</si:valueStandardMU></si:standardMU>"
    "</si:measurementUncertaintyUnivariate>"
)
SECOND = r"<si:realListXMLList><si:valueXMLList>293 294</si:valueXMLList><si:unitXMLList>\kelvin</si:unitXMLList>"


@pytest.mark.parametrize(
    ("other", "told"),
    [
        (
            real("thermalExpansionCoefficient", 11.9, r"\per\kelvin", STANDARD.format(0.2)),
            "expansion is 11.9 1/K",
        ),
        (real("thermalExpansionCoefficient", 1.2e-5, r"\per\kelvin", STANDARD.format(0.2)), "uncertainty of 0.2 1/K"),
        (real("thermalExpansionCoefficient", 1.2e-5, r"\per\kelvin", STANDARD.format(0.0)), "uncertainty of 0 1/K"),
        (real("referenceTemperature", 20.0, r"\kelvin"), "reference temperature is -253.15 °C"),
        (real("referenceTemperature", 1e300, r"\degreecelsius"), "reference temperature is 1e"),
        (quantity("referenceTemperature", f"{SECOND}</si:realListXMLList>"), "2 temperatures where one is expected"),
    ],
)
def test_what_no_artefact_can_have_is_refused(other: str, told: str) -> None:
    with pytest.raises(FormatError, match=told) as caught:
        parse_certificate(certificate(centres_with_covariance(TILTED.balls, covariance_of(5)), other), "c.xml")
    assert "quantity" in caught.value.where["element"]


def test_many_lists_of_one_kind_are_refused_before_they_are_joined() -> None:
    one = expanded_list("ballCentreX", np.ones(300), 1.2)
    with pytest.raises(FormatError, match="ballCentreX has more than 300 values") as caught:
        parse_certificate(certificate(one * 40), "c.xml")
    assert caught.value.where["element"].endswith("quantity[2]")
    axes = "".join(expanded_list(f"ballCentre{name}", np.ones(101), 1.2) for name in "XYZ")
    with pytest.raises(FormatError, match="101 balls are more than 100"):
        parse_certificate(certificate(axes), "c.xml")


def test_the_diameter_is_compared_with_that_of_the_artefact() -> None:
    centres = centres_with_covariance(TILTED.balls, covariance_of(5))
    nominal = real("ballDiameter", 20.0, r"\milli\metre").replace('refType="', 'refType="basic_nominalValue ')
    found = parse_certificate(certificate(centres, expanded_list("ballDiameter", [10.0] * 5, 0.5)), "c.xml")
    with pytest.raises(DataError, match=r"10\.0000 mm, that of the artefact 'bar' 20\.0000 mm"):
        certified_artefact(found, TILTED, "")
    both = certificate(centres, expanded_list("ballDiameter", [20.008], 0.5) + nominal)
    assert parse_certificate(both, "c.xml", ("basic_nominalValue",)).ball_diameter_mm == pytest.approx(20.008)


def test_correlated_distances_stay_correlated() -> None:
    """Lengths of one interferometer share its error: that of their difference is much smaller than their own."""
    lengths = np.linalg.norm(TILTED.balls[1:] - TILTED.balls[0], axis=1)
    stated = 1e-6 * (np.ones((4, 4)) + 1e-2 * np.eye(4))
    text = centres_with_covariance(lengths.reshape(1, -1), stated).replace("ballCentres", "ballDistances")
    found = certified_artefact(parse_certificate(certificate(text), "c.xml"), TILTED, "")
    lines = TILTED.balls[1:] - TILTED.balls[0]
    rows = np.zeros((4, 15))
    for ball, line in enumerate(lines, start=1):
        rows[ball - 1, 3 * ball : 3 * ball + 3] = line / np.linalg.norm(line)
        rows[ball - 1, :3] = -line / np.linalg.norm(line)
    assert rows @ found.covariance @ rows.T == pytest.approx(stated, rel=1e-3)


def test_distances_at_another_temperature_are_joined_to_centres_at_that_temperature() -> None:
    """22 °C instead of 20 °C: a certificate of the same artefact moves no ball but by its expansion."""
    warm = replace(TILTED, reference_temperature_c=22.0, cte_per_k=1e-5, covariance=1e-8 * TILTED.covariance)
    lengths = np.linalg.norm(warm.balls[1:] - warm.balls[0], axis=1) * (1.0 - 2e-5)
    found = certified_artefact(
        parse_certificate(certificate(expanded_list("ballDistances", lengths, 2.0)), "c.xml"), warm, ""
    )
    assert found.reference_temperature_c == 20.0
    assert found.balls == pytest.approx(warm.balls * (1.0 - 2e-5), abs=1e-5)


def test_the_earliest_end_of_the_validity_counts() -> None:
    end = "<dcc:date>2126-03-01</dcc:date>"
    for other, until in (
        ("<dcc:period>P1Y6M</dcc:period>", datetime.date(2015, 9, 1)),
        ("<dcc:period>P30D</dcc:period>", datetime.date(2014, 3, 31)),
        (
            f"{end}</dcc:statement><dcc:statement refType='basic_nextCalibrationDate'><dcc:date>2016-02-29Z</dcc:date>",
            datetime.date(2016, 2, 29),
        ),
    ):
        assert parse_certificate(GOOD.replace(end, other).encode(), "c.xml").identity.until == until


def test_what_a_certificate_states_against_itself_is_told() -> None:
    failed = "</si:realListXMLList><dcc:measurementMetaData><dcc:metaData><dcc:conformity>fail</dcc:conformity>"
    text = GOOD.replace("</si:realListXMLList>", f"{failed}</dcc:metaData></dcc:measurementMetaData>")
    assert "conformity 'fail'" in parse_certificate(text.encode(), "c.xml").warnings[0]
    text = GOOD.replace("<dcc:endPerf", "<dcc:reportAmendedSubstituted/><dcc:endPerf", 1)
    assert "amends or substitutes" in parse_certificate(text.encode(), "c.xml").warnings[0]


def test_foreign_text_cannot_look_like_a_statement() -> None:
    spoof = "Lab; signed by a trusted signer" + 300 * "."
    found = parse_certificate(GOOD.replace(">Laboratory<", f">{spoof}<").encode(), "c.xml").identity.text
    assert ";" not in found
    assert len(found) < 250


def test_what_is_not_needed_is_ignored_by_its_name() -> None:
    text = certificate(centres_with_covariance(TILTED.balls, covariance_of(5)), FORM)
    for name in ("Result 2", "volcal_roundness"):
        assert parse_certificate(text, "c.xml", (name,)).centres == pytest.approx(TILTED.balls)
    with pytest.raises(FormatError, match="no result or quantity 'waviness'"):
        parse_certificate(text, "c.xml", ("Result 2", "waviness"))
    with pytest.raises(FormatError, match="stated by two results"):
        parse_certificate(certificate(*[centres_with_covariance(TILTED.balls, covariance_of(5))] * 2), "c.xml")
    with pytest.raises(FormatError, match="neither ball centres nor distances"):
        parse_certificate(text, "c.xml", ("Result 1", "Result 2"))


def test_a_certificate_of_another_artefact_is_refused() -> None:
    found = parse_certificate(GOOD.encode(), "c.xml")
    swapped = replace(TILTED, balls=TILTED.balls[[1, 0, 2, 3, 4]])
    for other in (swapped, mirrored(TILTED)):
        with pytest.raises(DataError, match=r"ball \d of the certificate is"):
            certified_artefact(found, other, "")
    with pytest.raises(DataError, match="of 5 balls, the artefact 'straight' has 4"):
        certified_artefact(found, STRAIGHT, "")


def mirrored(artefact: Artefact) -> Artefact:
    return replace(artefact, balls=artefact.balls * np.array([1.0, 1.0, -1.0]))


@pytest.mark.parametrize(
    ("head", "told"),
    [
        ('<!DOCTYPE a [<!ENTITY b "c">]>', "document type declaration"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd">', "document type declaration"),
        ("<open>", "not valid XML"),
        ("\x00", "not valid XML"),
        ("<a>" * 300, "not valid XML"),
    ],
)
def test_hostile_xml_is_refused(head: str, told: str) -> None:
    with pytest.raises(FormatError, match=told):
        parse_xml(f"{head}<a/>".encode(), "c.xml")


def test_entities_that_grow_are_not_expanded() -> None:
    entities = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 12))
    with pytest.raises(FormatError):
        parse_xml(f'<!DOCTYPE a [<!ENTITY e0 "x">{entities}]><a b="&e11;">&e11;</a>'.encode(), "c.xml")


def test_a_file_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xml_reading, "MAX_BYTES", 10)
    with pytest.raises(FormatError, match="larger than"):
        parse_xml(b"<a>0123456789</a>", "c.xml")


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        (r"\metre", 1.0),
        (r"\milli\metre", 1e-3),
        (r"\micro\metre", 1e-6),
        (r"\nano\metre", 1e-9),
        (r"\kelvin\metre\per\kelvin", 1.0),
        (r"\metre\tothe{2}\per\metre", 1.0),
    ],
)
def test_units_of_length(unit: str, factor: float) -> None:
    assert factor_to(unit, METRE) == pytest.approx(factor, rel=1e-12)


def test_powers_and_quotients_of_units() -> None:
    assert parse_unit(r"\micro\metre\tothe{2}").factor == pytest.approx(1e-12)
    assert dict(parse_unit(r"\kelvin\tothe{-1}").exponents) == {"kelvin": -1}
    assert dict(parse_unit(r"\metre\per\metre\kelvin").exponents) == {"kelvin": -1}
    assert parse_unit(r"\per\milli\metre").factor == pytest.approx(1e3)
    for text in (
        "",
        "mm",
        r"\milli",
        r"\milli\milli\metre",
        r"\per",
        r"\metre\tothe",
        r"\metre\tothe{x}",
        "\\metre" * 99,
    ):
        with pytest.raises(DataError):
            parse_unit(text)


def test_older_and_other_forms_of_uncertainty_are_read() -> None:
    """D-SI before 2.1 for the covariance; an interval with its standard uncertainty; the first unit of a hybrid."""
    covariance = covariance_of(5)
    columns = "".join(
        "<si:column>"
        + "".join(
            f"<si:covariance><si:value>{1e-6 * float(one)!r}</si:value>"
            r"<si:unit>\metre\tothe{2}</si:unit></si:covariance>"
            for one in column
        )
        + "</si:column>"
        for column in covariance.T
    )
    old = quantity(
        "ballCentres",
        f"<si:realListXMLList><si:valueXMLList>{words(TILTED.balls)}</si:valueXMLList>"
        r"<si:unitXMLList>\milli\metre</si:unitXMLList>"
        f"<si:ellipsoidalRegionXMLList><si:covarianceMatrix>{columns}</si:covarianceMatrix>"
        "</si:ellipsoidalRegionXMLList></si:realListXMLList>",
    )
    expansion = quantity(
        "thermalExpansionCoefficient",
        r"<si:hybrid><si:real><si:value>0.0000119</si:value><si:unit>\kelvin\tothe{-1}</si:unit>"
        "<si:measurementUncertaintyUnivariate><si:coverageIntervalMU><si:valueStandardMU>2e-7</si:valueStandardMU>"
        "<si:intervalMin>1.15e-5</si:intervalMin><si:intervalMax>1.23e-5</si:intervalMax>"
        "</si:coverageIntervalMU></si:measurementUncertaintyUnivariate></si:real>"
        "<si:real><si:value>11.9</si:value><si:unit>ppm/K</si:unit></si:real></si:hybrid>",
    )
    reference = real("referenceTemperature", 20.5, r"\degreecelsius")
    found = parse_certificate(certificate(old + expansion + reference), "c.xml")
    assert found.covariance == pytest.approx(covariance)
    assert found.expansion == pytest.approx((11.9e-6, 0.2e-6))
    assert found.reference_temperature_c == 20.5


def test_a_covariance_must_agree_with_the_uncertainties_beside_it() -> None:
    doubt = (
        "<si:measurementUncertaintyUnivariateXMLList><si:standardMUXMLList><si:valueStandardMUXMLList>{}"
        "</si:valueStandardMUXMLList></si:standardMUXMLList></si:measurementUncertaintyUnivariateXMLList>"
        "<si:measurementUncertaintyMultivariateXMLList>"
    )
    sigma = np.sqrt(np.diagonal(covariance_of(5))) / 1e3
    for factor in (1.0, 1.2):
        text = GOOD.replace("<si:measurementUncertaintyMultivariateXMLList>", doubt.format(words(factor * sigma)))
        if factor == 1.0:
            assert parse_certificate(text.encode(), "c.xml").covariance == pytest.approx(covariance_of(5))
        else:
            with pytest.raises(FormatError, match="the covariance contradicts the uncertainties"):
                parse_certificate(text.encode(), "c.xml")


def test_a_certificate_in_place_of_an_artefact_file_is_told_where_to_go() -> None:
    with pytest.raises(FormatError, match="volcal artefact import"):
        parse_artefact(GOOD, "c.xml")
