"""The digital certificate of a report: its structure, its figures, both languages, and its signature."""

from __future__ import annotations

import base64
import datetime
import os
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from aloud import NOT_HERE
from dcc_structure import complaints
from lxml import etree
from signers import NOW, identity
from test_report import estimate_of, report_data

from agent.certificates.xml_signature import CREDENTIAL, Signer, Trust, check_signature, signer_of
from agent.reports.digital_certificate import from_journal
from agent.reports.digital_certificate.certificate_of_report import certificate_of_report
from agent.reports.page import ReportData, VerificationFacts
from agent.reports.page.error_table import error_rows
from agent.reports.page.render import render_report
from agent.reports.page.texts import ENGLISH
from agent.results import run_verdict
from agent.results.facts import Quantity
from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import CERTIFICATE
from agent.results.run_verdict import RunVerdict
from agent.settings.report import ReportSettings
from agent.thermal.thermometer import ThermometerFacts
from agent.workpiece.measured_repeats import MeasuredRepeats
from agent.workpiece.predicted_tests import PlaceOfTests, predicted_tests
from drivers.errors import ConfigurationError, InputError
from twin.compensation.table import build_table, regular_nodes
from twin.errors import FormatError
from twin.formats.toml_reading import validate_document
from twin.machine.anchor import Anchor
from twin.workpiece.features import Measure

DAY = datetime.date(2026, 3, 2)
STATED: dict[str, Any] = {
    "customer": "Customer & Co",
    "place": "Hall 3",
    "measured_by": "A. Example",
    "approved_by": "B. Example",
    "machine": {"maker": "Maker", "model": "M 5", "serial_number": "SN <7>"},
    "instruments": [
        {"kind": "probe", "name": "Probe", "serial_number": "P 1", "certificate": "C 1", "calibrated": "2025-01-01"}
    ],
    "tolerances": {"EXX": 1000.0, "EYY": 0.001, "VE": 1000.0, "VCE": 0.001},
    "laboratory": {"name": "Laboratory", "city": "Town", "country": "DE", "street": "Road 1"},
}
PATHS = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


def settings(**changes: Any) -> ReportSettings:
    return validate_document({**STATED, **changes}, "s", ReportSettings)


@pytest.fixture(scope="module")
def data() -> ReportData:
    plain = replace(report_data(), document=settings())
    offset = np.array(plain.tool_offset)
    measured = MeasuredRepeats({}, ())
    acceptance = predicted_tests(estimate_of(plain), table_for(plain), "a table", PlaceOfTests(offset), measured)
    assert plain.identification is not None
    return replace(plain, identification=replace(plain.identification, acceptance=acceptance))


@pytest.fixture(scope="module")
def root(data: ReportData) -> etree._Element:
    return read(certificate_of_report(proved(data), settings(), DAY, table=table_for(data), pdf=b"%PDF-1.7"))


def read(content: bytes) -> etree._Element:
    return etree.fromstring(content)


def proved(data: ReportData) -> ReportData:
    proof = VerificationFacts(True, "better", Quantity(9.0), Quantity(2.0), 2.1)
    return replace(data, run=replace(data.run, verification=proof, times=(("Started", "2026-02-28 20:00:00 UTC"),)))


def table_for(data: ReportData) -> Any:
    estimate = estimate_of(data)
    nodes = regular_nodes(estimate.model.ranges_mm, (250.0, 250.0, 250.0))
    return build_table(
        estimate.model, estimate.parameters, nodes, np.array(data.tool_offset), Anchor(np.zeros(3)), np.zeros((1, 3))
    )


def texts(root: etree._Element, path: str) -> list[str]:
    return [str(one.text) for one in root.findall(path, PATHS)]


def quantity(root: etree._Element, reference: str) -> etree._Element:
    (found,) = (one for one in root.iter(f"{{{PATHS['dcc']}}}quantity") if reference in one.get("refType", "").split())
    return found


def test_the_structure_is_that_of_the_published_schema(root: etree._Element, data: ReportData) -> None:
    assert list(complaints(root)) == []
    # also the least that a certificate can state
    least = settings(measured_by=None, place=None, instruments=[], tolerances={}, machine={"serial_number": "7"})
    bare = replace(data, document=least)
    assert list(complaints(read(certificate_of_report(bare, least, DAY)))) == []


def test_the_structure_test_finds_what_is_wrong(root: etree._Element) -> None:
    """The reading of the schema in dcc_structure.py itself."""
    for old, new in (
        (b"<dcc:issuer>manufacturer</dcc:issuer>", b""),
        (b"<dcc:issuer>manufacturer", b"<dcc:issuer>nobody"),
        (b"<si:coverageFactor>2<", b"<si:coverageFactor>0.5<"),
        (b"<dcc:mainSigner>true</dcc:mainSigner>", b"<dcc:mainSigner>true</dcc:mainSigner><dcc:role>a</dcc:role>"),
        (b'schemaVersion="3.3.0"', b'schemaVersion="3.2.1"'),
        (b"si:real>", b"dcc:real>"),
        (rb"<si:unit>\micro\metre<", "<si:unit>µm<".encode()),
        (b"<dcc:administrativeData>", b"<dcc:administrativeData><dcc:coreData/>"),
        (b' lang="de"', b' language="de"'),
    ):
        content = etree.tostring(root, encoding="UTF-8")
        assert old in content
        assert list(complaints(read(content.replace(old, new)))) != []


SCHEMA_FOLDER = "VOLCAL_DCC_SCHEMA"
"""Environment variable with a folder that holds dcc.xsd (3.3.0) with the files that it imports; see
docs/how-to/digital-certificates.md."""


def test_it_is_valid_against_the_published_schema(root: etree._Element, data: ReportData, tmp_path: Path) -> None:
    """With the schema of PTB, which is not part of this repository (LGPL-3.0)."""
    folder = os.environ.get(SCHEMA_FOLDER)
    if not folder or not (Path(folder) / "dcc.xsd").is_file():
        pytest.skip(f"{NOT_HERE}: {SCHEMA_FOLDER} names no folder with dcc.xsd, the schema of PTB")
    schema = etree.XMLSchema(etree.parse(Path(folder) / "dcc.xsd", local_parser(Path(folder))))
    signed = certificate_of_report(data, settings(), DAY, signer=signer_in(tmp_path))
    for one in (root, read(signed)):
        schema.assertValid(one)


def local_parser(folder: Path) -> etree.XMLParser:
    """Return a parser that finds what a schema imports by its file name in the folder, and never in the network."""

    class Local(etree.Resolver):
        def resolve(self, system_url: str, _: str, context: object) -> Any:  # type: ignore[override]
            found = next(folder.rglob(system_url.rsplit("/", 1)[-1]), None)
            return None if found is None else self.resolve_filename(str(found), context)  # type: ignore[attr-defined]

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Local())
    return parser


def signer_in(folder: Path) -> Signer:
    who = identity("Laboratory")
    (folder / "key.pem").write_bytes(who.key_pem)
    (folder / "key.pem").chmod(0o600)
    (folder / "cert.pem").write_bytes(who.pem)
    return Signer.read(folder / "key.pem", folder / "cert.pem", NOW)


def test_the_figures_are_those_of_the_report(root: etree._Element, data: ReportData) -> None:
    found = data.identification
    assert found is not None
    for reference, value in (
        ("volcal_volumetricError", found.volumetric.before_aligned),
        ("volcal_volumetricCompensatedError", found.volumetric.after_aligned),
    ):
        one = quantity(root, reference)
        assert float(texts(one, "si:real/si:value")[0]) == pytest.approx(value.value_um, abs=1e-4)
        assert texts(one, "si:real/si:unit") == [r"\micro\metre"]
        limits = [float(texts(one, f".//si:interval{end}")[0]) for end in ("Min", "Max")]
        assert limits == pytest.approx(value.limits_um, abs=1e-4)
        assert value.standard_uncertainty_um is not None
        assert float(texts(one, ".//si:valueStandardMU")[0]) == pytest.approx(value.standard_uncertainty_um, abs=1e-4)
    rows = error_rows(found)
    assert len(rows) == 21
    for row in rows:
        one = quantity(root, f"iso230-1_{row.name}")
        assert float(texts(one, "si:real/si:value")[0]) == pytest.approx(row.size, abs=1e-4)
        assert float(texts(one, ".//si:valueExpandedMU")[0]) == pytest.approx(row.expanded_uncertainty, abs=1e-4)
        assert texts(one, ".//si:coverageFactor") == ["2"]
        assert texts(one, "si:real/si:unit") == [r"\micro\metre" if row.unit == "µm" else r"\micro\radian"]
    assert texts(quantity(root, "volcal_heldOutResidual"), "si:real/si:value") == ["2.0000"]
    figures = [
        one for one in root.iter(f"{{{PATHS['dcc']}}}quantity") if "volcal_acceptanceFigure" in one.get("refType", "")
    ]
    assert data.identification is not None
    assert data.identification.acceptance is not None
    tests = data.identification.acceptance.all_tests
    errors = [one.figure.without_table for one in tests] + [one.figure.with_table for one in tests]
    assert len(figures) == len(errors)
    for one, error, measure in zip(figures, errors, [one.test.feature.measure for one in tests] * 2, strict=True):
        assert error is not None
        assert float(texts(one, "si:real/si:value")[0]) == pytest.approx(1e3 * error.expected_mm, abs=1e-4)
        if measure is Measure.SIGNED:
            assert float(texts(one, ".//si:valueExpandedMU")[0]) == pytest.approx(1e3 * error.expanded_mm, abs=1e-4)
        else:
            limits = [float(texts(one, f".//si:interval{end}")[0]) for end in ("Min", "Max")]
            assert limits == pytest.approx([1e3 * error.low_mm, 1e3 * error.high_mm], abs=1e-4)
    temperatures = [texts(quantity(root, f"basic_temperature{end}"), "si:real/si:value") for end in ("Min", "Max")]
    assert temperatures == [["20.5000"]] * 2


def test_conformity_is_stated_as_in_the_report(root: etree._Element, data: ReportData) -> None:
    assert texts(quantity(root, "iso230-1_EXX"), ".//dcc:conformity") == ["pass"]
    assert texts(quantity(root, "volcal_volumetricError"), ".//dcc:conformity") == ["pass"]
    assert texts(quantity(root, "volcal_volumetricCompensatedError"), ".//dcc:conformity") == ["fail"]
    assert texts(quantity(root, "iso230-1_EZZ"), ".//dcc:metaData") == []
    # the table is not active without a proof, so nothing is stated about it
    plain = read(certificate_of_report(data, settings(), DAY))
    assert texts(quantity(plain, "volcal_volumetricCompensatedError"), ".//dcc:metaData") == []
    assert "predicted: the table was not active" in etree.tostring(plain, encoding="unicode")


def statements(root: etree._Element) -> dict[str, str]:
    """Return the English name and declaration of each statement."""
    found = root.findall("dcc:administrativeData/dcc:statements/dcc:statement", PATHS)
    english = "dcc:content[@lang='en']"
    return {
        texts(one, f"dcc:name/{english}")[0]: (texts(one, f"dcc:declaration/{english}") or [""])[0] for one in found
    }


@pytest.mark.parametrize(
    "verdict", [run_verdict.REFUSED, run_verdict.FAULTED, run_verdict.ABORTED, run_verdict.PROOF_FAILED]
)
def test_no_conformity_is_stated_for_a_run_that_did_not_end_well(verdict: RunVerdict, data: ReportData) -> None:
    gate = Gate(CERTIFICATE, False, 3.0, 1.0, "ball 3 contradicts its certificate")
    bad = replace(data, header=replace(data.header, verdict=verdict), gates=(gate,))
    made = read(certificate_of_report(bad, settings(), DAY))
    assert list(complaints(made)) == []
    assert texts(made, ".//dcc:conformity") == []
    told = statements(made)
    assert told[verdict.word["en"]] == verdict.sentence["en"]
    assert "No conformity with a tolerance is stated" in told["Limitations of the results"]
    assert "ball 3 contradicts its certificate" in told["Limitations of the results"]
    assert verdict.sentence["de"] in etree.tostring(made, encoding="unicode")
    report = render_report(replace(bad, document=settings()))
    assert "No conformity with a tolerance is stated" in report
    assert "conforms" not in report


def test_a_table_that_was_taken_back_after_its_proof_is_not_active(data: ReportData) -> None:
    limited = replace(proved(data), document=settings(tolerances={"VCE": 1000.0}))
    for verdict, active in ((run_verdict.ACCEPTED, True), (run_verdict.FAULTED, False)):
        ended = replace(limited, header=replace(data.header, verdict=verdict))
        made = etree.tostring(read(certificate_of_report(ended, settings(), DAY)), encoding="unicode")
        assert ("The compensation table was active after the run" in made) is active
        assert ("conforms" in render_report(ended)) is active


def test_the_decision_rule_is_stated_with_a_conformity(root: etree._Element, data: ReportData) -> None:
    assert "guard band of U" in statements(root)["Decision rule"]
    without = settings(tolerances={})
    assert "Decision rule" not in statements(read(certificate_of_report(replace(data, document=without), without, DAY)))


def test_a_temperature_that_nobody_measured_is_no_condition(data: ReportData) -> None:
    assert data.identification is not None
    unread = ThermometerFacts(1.0, False, False, 11.5, 3.0, 2.0)
    made = read(
        certificate_of_report(
            replace(data, identification=replace(data.identification, thermometer=unread)), settings(), DAY
        )
    )
    assert list(complaints(made)) == []
    assert list(made.iter(f"{{{PATHS['dcc']}}}influenceCondition")) == []
    assert "The temperature of the artefact was not measured" in etree.tostring(made, encoding="unicode")


def test_notes_that_are_left_out_are_counted(data: ReportData) -> None:
    many = tuple(f"warning {number} {'x' * 200}" for number in range(200))
    made = read(certificate_of_report(replace(data, warnings=many), settings(), DAY))
    note = statements(made)[ENGLISH["note"]]
    left = 200 - note.count("warning ")
    assert 0 < left < 200
    assert f"{left} further notes are left out here" in note


def test_a_range_is_not_said_to_be_normal(root: etree._Element) -> None:
    assert texts(quantity(root, "iso230-1_EXX"), ".//si:distribution") == []
    assert texts(quantity(root, "iso230-1_C0Y"), ".//si:distribution") == ["normal"]


def test_it_is_not_issued_before_the_run_has_ended(data: ReportData) -> None:
    with pytest.raises(InputError, match="before the end of the run on 2026-03-01"):
        certificate_of_report(data, settings(), datetime.date(2026, 2, 28))


def test_persons_and_places_are_those_of_the_run(data: ReportData) -> None:
    once = settings(place=None, measured_by=None, approved_by="Old Chief", number_prefix=None)
    made = read(certificate_of_report(replace(data, document=once), settings(number_prefix="C-"), DAY))
    head = "dcc:administrativeData"
    assert texts(made, f"{head}/dcc:respPersons/dcc:respPerson/dcc:person/dcc:name/dcc:content") == ["Old Chief"]
    assert texts(made, f"{head}/dcc:coreData/dcc:uniqueIdentifier") == ["run-17"]
    assert "Hall 3" not in etree.tostring(made, encoding="unicode")
    nobody = replace(data, document=settings(measured_by=None, approved_by=None))
    with pytest.raises(ConfigurationError, match=r"report\.measured_by") as caught:
        certificate_of_report(nobody, settings(), DAY)
    assert "before the run begins" in caught.value.hint


def test_the_pdf_is_printed_from_the_completed_document(
    data: ReportData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the run did not state stands in the certificate and in the PDF inside of it."""
    once = replace(data, document=settings(customer=None))
    monkeypatch.setattr(from_journal, "read_record", lambda *_: SimpleNamespace(table=lambda _: None))
    monkeypatch.setattr(from_journal, "report_of", lambda _: once)
    monkeypatch.setattr(from_journal, "open_journal", lambda _: nullcontext())
    monkeypatch.setattr(from_journal, "render_report", lambda shown, language: str(shown.document.customer))
    monkeypatch.setattr(from_journal, "render_pdf", lambda html: html.encode())
    made = from_journal.certificate_from_journal(tmp_path, "run-17", settings(), DAY, language="en", with_pdf=True)
    (held,) = texts(read(made), "dcc:document/dcc:dataBase64")
    assert base64.b64decode(held) == b"Customer & Co"


def test_who_certifies_what(root: etree._Element) -> None:
    head = "dcc:administrativeData"
    core = f"{head}/dcc:coreData"
    assert texts(root, f"{core}/dcc:uniqueIdentifier") == ["run-17"]
    assert texts(root, f"{core}/dcc:beginPerformanceDate") == ["2026-02-28"]
    assert texts(root, f"{core}/dcc:endPerformanceDate") == ["2026-03-01"]
    assert texts(root, f"{core}/dcc:issueDate") == ["2026-03-02"]
    assert texts(root, f"{head}/dcc:items/dcc:item/dcc:name/dcc:content") == ["mill <5>"]
    assert texts(root, f"{head}/dcc:items/dcc:item/dcc:identifications/dcc:identification/dcc:value") == ["SN <7>"]
    assert texts(root, f"{head}/dcc:customer/dcc:name/dcc:content") == ["Customer & Co"]
    assert texts(root, f"{head}/dcc:calibrationLaboratory/dcc:contact/dcc:name/dcc:content") == ["Laboratory"]
    assert texts(root, f"{head}/dcc:respPersons/dcc:respPerson/dcc:person/dcc:name/dcc:content") == [
        "B. Example",
        "A. Example",
    ]
    equipment = "dcc:measurementResults/dcc:measurementResult/dcc:measuringEquipments/dcc:measuringEquipment"
    assert "Probe" in texts(root, f"{equipment}/dcc:name/dcc:content")
    assert {"P 1", "C 1"} <= set(texts(root, f"{equipment}/dcc:identifications/dcc:identification/dcc:value"))
    assert "not a calibration certificate of an accredited laboratory" in etree.tostring(root, encoding="unicode")
    (held,) = texts(root, "dcc:document/dcc:dataBase64")
    assert base64.b64decode(held) == b"%PDF-1.7"


def test_each_sentence_of_the_program_is_in_both_languages(root: etree._Element) -> None:
    """German is not English, except for a word that is the same in both."""
    same = set()
    for parent in {one.getparent() for one in root.iter(f"{{{PATHS['dcc']}}}content")}:
        assert parent is not None
        english, german = ([one.text for one in parent if one.get("lang") == language] for language in ("en", "de"))
        assert len(english) == len(german) <= 1  # Good Practice of PTB: one content for each language
        same |= {one for one in english if one in german}
    assert same <= {"Thermometer"}


@pytest.mark.parametrize(
    ("changes", "keys"),
    [
        ({"laboratory": {}}, ["report.laboratory.name", "report.laboratory.city", "report.laboratory.country"]),
        ({"customer": None}, ["report.customer"]),
        ({"machine": {}}, ["report.machine.serial_number"]),
        ({"measured_by": None, "approved_by": None}, ["report.measured_by"]),
    ],
)
def test_what_the_settings_must_state_is_named(changes: dict[str, Any], keys: Sequence[str], data: ReportData) -> None:
    lacking = settings(**changes)
    with pytest.raises(ConfigurationError, match=", ".join(keys)) as caught:
        certificate_of_report(replace(data, document=lacking), lacking, DAY)
    assert caught.value.where["key"] == keys[0]


def test_what_a_run_did_not_state_is_that_of_the_present_settings(data: ReportData) -> None:
    once = settings(customer=None, machine={"maker": "Old"}, laboratory={})
    made = read(certificate_of_report(replace(data, document=once), settings(), DAY))
    assert texts(made, "dcc:administrativeData/dcc:customer/dcc:name/dcc:content") == ["Customer & Co"]
    item = "dcc:administrativeData/dcc:items/dcc:item"
    assert texts(made, f"{item}/dcc:manufacturer/dcc:name/dcc:content") == ["Old"]
    assert texts(made, f"{item}/dcc:model") == ["M 5"]


def test_a_run_without_estimate_has_no_certificate(data: ReportData) -> None:
    with pytest.raises(InputError, match="no result that can be certified"):
        certificate_of_report(replace(data, identification=None), settings(), DAY)


def test_a_signed_certificate_is_trusted_and_a_change_is_found(data: ReportData, tmp_path: Path) -> None:
    signed = certificate_of_report(data, settings(), DAY, signer=signer_in(tmp_path))
    assert list(complaints(read(signed))) == []
    assert check_signature(signed, "c.xml", [tmp_path / "cert.pem"]).trust is Trust.TRUSTED
    with pytest.raises(InputError, match="the signature is not valid"):
        check_signature(signed.replace(b"SN &lt;7&gt;", b"SN 8"), "c.xml")


def test_a_signer_needs_a_key_of_its_own_and_its_certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    signer_in(tmp_path)
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    assert signer_of(None, None, NOW, key_is_stated=False) is None
    for one, other in ((key, None), (None, certificate)):
        with pytest.raises(ConfigurationError, match="needs both a key and its certificate"):
            signer_of(one, other, NOW, key_is_stated=False)
    assert signer_of(key, certificate, NOW, key_is_stated=True) is not None
    key.chmod(0o644)
    with pytest.raises(ConfigurationError, match=r"can be read by others \(mode 0644\)"):
        signer_of(key, certificate, NOW, key_is_stated=True)
    handed = tmp_path / "credentials"
    handed.mkdir()
    (handed / CREDENTIAL).write_bytes(key.read_bytes())
    (handed / CREDENTIAL).chmod(0o440)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(handed))
    assert signer_of(key, certificate, NOW, key_is_stated=False) is not None


@pytest.mark.parametrize("changes", [{"country": "de"}, {"country": "DEU"}, {"performed_at": "home"}, {"town": "x"}])
def test_a_laboratory_that_cannot_be_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(FormatError, match=rf"laboratory\.{next(iter(changes))}"):
        settings(laboratory=changes)


def test_it_follows_the_rules_of_good_practice(root: etree._Element, data: ReportData) -> None:
    """The Schematron rules that PTB publishes with dcclib, if that package is installed; it is not a dependency."""
    if find_spec("dcclib") is None:
        pytest.skip(f"{NOT_HERE}: dcclib with the rules of good practice of PTB is not installed")
    validator = import_module("dcclib.validation.schematron").SchematronValidator.for_dcc()

    def errors(text: str) -> list[str]:
        found = validator.validate_str(text)
        return [one.text for one in (*found.failed_assertions, *found.successful_reports) if one.role == "error"]

    for one in (root, read(certificate_of_report(data, settings(), DAY))):
        text = etree.tostring(one, encoding="unicode")
        assert errors(text) == []
        assert errors(text.replace(">v1.2.3<", ">1.2.3<")) != []
