"""The page's catalogue: both languages, every message that is used, every state, alarm, kind and table word."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from agent.execution.states import RunState
from agent.language.records import record_words
from agent.planning.new_machine.field import SetupField
from agent.planning.new_machine.fields import FIELDS, SETUP_FIELDS, catalogue
from agent.results.gates.gate_rules import GATE_RULES
from agent.results.run_verdict import verdict_words
from agent.runs.kinds.restoration import TABLE_ROLES
from agent.runs.run_kinds import KINDS
from agent.runs.run_request import SOURCES
from agent.service.alarms import CODES, DEFECT, AlarmCode
from agent.service.setup.axis_check import Finding, Part, ProbeFinding

ASSETS = Path(__file__).parents[3] / "agent" / "service" / "page" / "assets"
SCRIPTS = sorted(ASSETS.glob("*.js"))
CATALOGUES = [
    json.loads((ASSETS / name).read_text(encoding="utf-8")) for name in ("messages.json", "setup-messages.json")
]
FIELD_WORDS = catalogue()
SERVED_WORDS = {**verdict_words(), **record_words()}
MESSAGES: dict[str, dict[str, str]] = {**CATALOGUES[0], **CATALOGUES[1], **FIELD_WORDS, **SERVED_WORDS}
LANGUAGES = {"en", "de"}

KEY = re.compile(r'"([a-z]+\.[\w.]+)"')
BUILT = re.compile(r"`([a-z]+\.(?:[a-z]+_)?)\$\{")
NAMED = re.compile(r'data-(?:text|label)="([^"]+)"')
PLACE = re.compile(r"\{(\w+)\}")
WORDS = re.compile(r'"[^"\n]*[A-Za-z]{3,} [a-z]{2,} [a-z]{2,}[^"\n]*"')
NO_KEYS = {"records.json", "german.json", "verdicts.json"} | {
    f"volcal.{name}" for name in ("language", "theme", "token", "paired")
}


def used() -> set[str]:
    """Keys that stand in scripts and document as they are."""
    keys = {key for script in SCRIPTS for key in KEY.findall(script.read_text(encoding="utf-8"))}
    names = {path.name for path in ASSETS.iterdir()}
    documents = "".join((ASSETS / name).read_text(encoding="utf-8") for name in ("index.html", "setup.html"))
    return (keys | set(NAMED.findall(documents))) - NO_KEYS - names


def built() -> set[str]:
    return {start for script in SCRIPTS for start in BUILT.findall(script.read_text(encoding="utf-8"))}


def named(state: RunState) -> str:
    return re.sub(r"[ ,]+", "_", state.value)


@pytest.mark.parametrize("key", MESSAGES)
def test_each_message_is_there_in_both_languages_with_the_same_places(key: str) -> None:
    texts = MESSAGES[key]
    assert set(texts) == LANGUAGES
    assert all(text.strip() for text in texts.values())
    assert set(PLACE.findall(texts["en"])) == set(PLACE.findall(texts["de"]))


def test_each_message_that_is_used_exists_and_each_that_exists_is_used() -> None:
    assert used() - set(MESSAGES) - {f"problem.{status}" for status in (401, 403, 409)} == set()
    starts = built() | {"alarm.", "problem.", "kind.", "source."}
    starts |= {f"{name}." for name in FIELDS}
    assert {key for key in MESSAGES if key not in used() and not key.startswith(tuple(starts))} == set()


def test_no_message_stands_in_two_catalogues() -> None:
    assert len(MESSAGES) == len(CATALOGUES[0]) + len(CATALOGUES[1]) + len(FIELD_WORDS) + len(SERVED_WORDS)


@pytest.mark.parametrize("field", SETUP_FIELDS, ids=lambda field: field.name)
def test_each_field_of_a_set_up_has_the_words_of_its_step_and_its_kind(field: SetupField[Any]) -> None:
    assert {f"step.{field.step}", f"about.{field.step}", f"expected.{field.kind.value}"} <= set(MESSAGES)


def test_each_finding_and_each_gate_of_a_forecast_has_its_words() -> None:
    findings = {
        f"finding.{finding.value.replace(' ', '_')}" for finding in Finding if finding is not Finding.WRONG_SIDE
    }
    sides = {f"finding.wrong_side_{part.value}" for part in Part}
    touches = {f"touch.{finding.value.replace(' ', '_')}" for finding in ProbeFinding}
    gates = {f"{word}.{gate.replace(' ', '_')}" for word in ("gate", "remedy") for gate in GATE_RULES}
    assert findings | sides | touches | gates <= set(MESSAGES)


@pytest.mark.parametrize("state", RunState)
def test_each_state_has_its_word_and_its_sentence_and_its_shape(state: RunState) -> None:
    assert f"state.{named(state)}" in MESSAGES
    assert f"doing.{named(state)}" in MESSAGES
    looks = (ASSETS / "wording.js").read_text(encoding="utf-8").split("LOOKS = {")[1].split("}")[0]
    assert re.search(rf'(^|[\s"]){re.escape(state.value)}"?: "', looks)


@pytest.mark.parametrize("code", [*CODES.values(), DEFECT], ids=lambda code: code.code)
def test_each_alarm_has_its_title_and_what_to_do(code: AlarmCode) -> None:
    assert f"alarm.{code.code}" in MESSAGES
    assert f"alarm.{code.code}.do" in MESSAGES


def test_no_alarm_in_the_catalogue_is_none_of_ours() -> None:
    ours = {f"{code.code}" for code in (*CODES.values(), DEFECT)}
    assert {key.split(".")[1] for key in MESSAGES if re.match(r"alarm\.\d", key)} == ours


def test_kinds_sources_and_roles_have_their_words() -> None:
    wanted = [f"kind.{kind}" for kind in (*KINDS, "restore")]
    wanted += [f"source.{source.replace(' ', '_')}" for source in SOURCES]
    wanted += [f"table.{role}" for role in (*TABLE_ROLES, "active", "accepted", "waiting")]
    assert [key for key in wanted if key not in MESSAGES] == []


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_no_sentence_stands_in_a_script(script: Path) -> None:
    text = re.sub(r"/\*.*?\*/", "", script.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert WORDS.findall(text) == []


@pytest.mark.parametrize("path", sorted(ASSETS.iterdir()), ids=lambda path: path.name)
def test_nothing_is_fetched_from_elsewhere_and_no_script_stands_in_the_document(path: Path) -> None:
    text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?://|//cdn|\beval\(|new Function|innerHTML", text)
    if path.suffix == ".html":
        assert not re.search(r"<script(?![^>]*\bsrc=)|\son\w+=|<style|\sstyle=", text)
