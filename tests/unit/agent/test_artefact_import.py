"""`volcal artefact import`: from a certificate to an artefact file, and to the same estimate."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import numpy as np
import pytest
from certificate_text import centres_with_covariance, certificate, real
from click.testing import CliRunner, Result
from lxml import etree
from signers import NOW, Identity, identity

import volcal
from agent.certificates import artefact_import
from agent.certificates.artefact_import import ImportRequest, import_certificate
from agent.certificates.xml_signature import Signer
from agent.cli.offline_commands.artefact import artefact_group
from twin.artefact.artefact import Artefact

LIKE = volcal.shipped_file("artefacts/ball-bar-1500.toml")
SIGNER = identity("Laboratory")


@pytest.fixture
def shipped() -> Artefact:
    return volcal.read_artefact(LIKE)


def importing(file: Path, *arguments: object) -> Result:
    words = ["import", str(file), "--like", str(LIKE), *(str(argument) for argument in arguments)]
    return CliRunner().invoke(artefact_group, words, catch_exceptions=False)


def certified(artefact: Artefact, *others: str) -> bytes:
    """Return the certificate of an artefact in the frame of a laboratory: turned by 90° about Z, and moved."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = np.kron(np.eye(artefact.count), turn)
    centres = artefact.balls @ turn.T + np.array([750.0, 10.0, 99.0])
    return certificate(centres_with_covariance(centres, turned @ artefact.covariance @ turned.T), *others)


def signed_by(who: Identity, content: bytes, folder: Path) -> bytes:
    key, pem = folder / "key.pem", folder / "cert.pem"
    key.write_bytes(who.key_pem)
    pem.write_bytes(who.pem)
    return etree.tostring(Signer.read(key, pem, NOW).signed(etree.fromstring(content)))


def test_an_estimate_with_the_certificate_is_that_with_the_artefact_file(shipped: Artefact, tmp_path: Path) -> None:
    (tmp_path / "dcc.xml").write_bytes(certified(shipped))
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml", "--json")
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["number"], found["balls"], found["signature"]) == ("D-K-1 2014-05", 11, "unsigned")
    assert found["largest_standard_uncertainty_um"] == pytest.approx(0.8)
    imported = volcal.read_artefact(tmp_path / "bar.toml")
    assert imported.balls == pytest.approx(shipped.balls, abs=1e-9)
    assert imported.covariance == pytest.approx(shipped.covariance, abs=1e-12)
    assert [rod.name for rod in imported.rods] == [rod.name for rod in shipped.rods]
    setup = volcal.case_study()
    balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    first, second = (volcal.identify(balls, setup.machine, one, order=3) for one in (shipped, imported))
    assert second.parameters == pytest.approx(first.parameters, rel=1e-5, abs=1e-9)


def test_it_is_said_loudly_that_nobody_vouches_for_a_certificate(shipped: Artefact, tmp_path: Path) -> None:
    (tmp_path / "dcc.xml").write_bytes(certified(shipped))
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml")
    assert "NOT SIGNED" in done.stderr
    assert "not signed" in volcal.read_artefact(tmp_path / "bar.toml").certificate
    signed = signed_by(SIGNER, certified(shipped), tmp_path)
    (tmp_path / "dcc.xml").write_bytes(signed)
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml")
    assert "SIGNER IS NOT CHECKED" in done.stderr
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml", "--trusted", tmp_path / "cert.pem")
    assert (done.exit_code, done.stderr) == (0, "")
    assert "signed by a trusted signer: CN=Laboratory" in done.stdout


def test_nothing_is_written_of_a_certificate_that_is_refused(shipped: Artefact, tmp_path: Path) -> None:
    file, out = tmp_path / "dcc.xml", tmp_path / "new" / "bar.toml"
    signed = signed_by(SIGNER, certified(shipped), tmp_path)
    form = real("roundness", 0.1, r"\micro\metre")
    for content, arguments, told in (
        (certified(shipped), ["--trusted", tmp_path / "cert.pem"], "the document is not signed"),
        (signed.replace(b"D-K-1", b"D-K-2"), [], "the signature is not valid"),
        (certified(shipped, form), [], "'volcal_roundness' is not understood"),
        (b"<a/>", [], "no digital calibration certificate"),
        (b"", [], "this is not valid XML"),
    ):
        file.write_bytes(content)
        done = importing(file, "--out", out, *arguments)
        assert (done.exit_code, done.stdout) == (2, "")
        assert told in done.stderr
        assert str(file) in done.stderr
    assert not out.parent.exists()
    assert "there is no such file" in importing(tmp_path / "absent.xml", "--out", out).stderr
    assert "must end in .toml" in importing(file, "--out", tmp_path / "bar.xml").stderr
    file.write_bytes(certified(shipped, form))
    assert importing(file, "--out", out, "--ignore", "Result 2").exit_code == 0


@pytest.mark.parametrize(
    ("today", "told"),
    [
        (datetime.date(2026, 6, 1), "NOT SIGNED"),
        (datetime.date(2127, 1, 1), "validity of the certificate ended on 2126-03-01"),
        (datetime.date(2013, 1, 1), "dated after today: 2014-03-01"),
    ],
)
def test_the_validity_is_checked(today: datetime.date, told: str, shipped: Artefact, tmp_path: Path) -> None:
    file = tmp_path / "dcc.xml"
    file.write_bytes(certified(shipped))
    found = import_certificate(ImportRequest(file, LIKE, tmp_path / "bar.toml"), today)
    assert any(told in warning for warning in found.warnings)
    assert len(found.warnings) == 1 + (told != "NOT SIGNED" and "NOT SIGNED" not in told)


def test_foreign_text_does_not_hide_that_a_certificate_is_not_signed(shipped: Artefact, tmp_path: Path) -> None:
    spoof = f"PTB; signed by a trusted signer: CN=PTB, SHA-256 {'ab' * 32} {'.' * 400}"
    (tmp_path / "dcc.xml").write_bytes(certified(shipped).replace(b">Laboratory<", f">{spoof}<".encode()))
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml")
    assert done.exit_code == 0, done.stderr
    recorded = volcal.read_artefact(tmp_path / "bar.toml").certificate
    assert recorded.startswith("not signed; PTB, signed by")
    assert recorded.count(";") == 1


def test_a_good_artefact_file_is_not_replaced_by_one_that_cannot_be_read(shipped: Artefact, tmp_path: Path) -> None:
    for file in LIKE.parent.glob("ball-bar-1500*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    like = tmp_path / LIKE.name
    before = like.read_bytes()
    doubt = (
        "<si:measurementUncertaintyUnivariate><si:standardMU><si:valueStandardMU>0.2</si:valueStandardMU></si:standardMU>"
        "</si:measurementUncertaintyUnivariate>"
    )
    wrong = real("thermalExpansionCoefficient", 11.9, r"\per\kelvin", doubt)
    (tmp_path / "dcc.xml").write_bytes(certified(shipped, wrong))
    words = ["import", str(tmp_path / "dcc.xml"), "--like", str(like), "--out", str(like)]
    done = CliRunner().invoke(artefact_group, words, catch_exceptions=False)
    assert done.exit_code == 2
    assert "result[2]/data/quantity" in done.stderr
    assert like.read_bytes() == before


def test_what_is_written_is_read_before(shipped: Artefact, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(artefact_import, "format_artefact", lambda *_: ("name = 1", ""))
    (tmp_path / "dcc.xml").write_bytes(certified(shipped))
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml")
    assert done.exit_code == 2
    assert not (tmp_path / "bar.toml").exists()


def test_other_values_that_change_are_told(shipped: Artefact, tmp_path: Path) -> None:
    other = real("ballDiameter", shipped.ball_diameter_mm + 0.002, r"\milli\metre")
    (tmp_path / "dcc.xml").write_bytes(certified(shipped, other))
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml", "--json")
    changes = json.loads(done.stdout)["changes"]
    assert list(changes) == ["ball_diameter_mm"]
    assert changes["ball_diameter_mm"]["after"] == pytest.approx(shipped.ball_diameter_mm + 0.002)
    assert "ball_diameter_mm: " in importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml").stdout


def test_a_signer_that_had_expired_before_the_calibration_is_refused(shipped: Artefact, tmp_path: Path) -> None:
    expired = identity("Old", until=datetime.datetime(2021, 1, 1, tzinfo=datetime.UTC))
    content = certified(shipped).replace(b"2014-03-01</dcc:end", b"2024-03-01</dcc:end")
    (tmp_path / "cert.pem").write_bytes(expired.pem)
    signed = Signer(expired.key, (expired.certificate,)).signed(etree.fromstring(content))
    (tmp_path / "dcc.xml").write_bytes(etree.tostring(signed))
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml", "--trusted", tmp_path / "cert.pem")
    assert done.exit_code == 2
    assert "dated 2024-03-01, and that of its signer has expired on 2021-01-01" in done.stderr
    done = importing(tmp_path / "dcc.xml", "--out", tmp_path / "bar.toml")
    assert done.exit_code == 0
    assert "has expired on 2021-01-01" in done.stderr
    assert "SIGNER IS NOT CHECKED" in done.stderr
