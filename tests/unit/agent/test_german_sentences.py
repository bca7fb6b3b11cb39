"""German for every sentence of the source that an operator may read, with the same places."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from importlib import resources

import pytest
from sentences_in_source import all_texts, sentences

from agent.language.records import WORDS, record_in_words
from agent.language.sentences import (
    PLACE,
    Sentence,
    catalogue,
    german,
    in_language,
    with_german_numbers,
)
from agent.results.gates.gate_rules import GATE_RULES
from drivers.foreign_errors import (
    BY_CERTIFICATE_CODE,
    BY_ERRNO,
    BY_SQLITE_CODE,
    IN_THE_LOG,
    NO_TLS,
    UNKNOWN_NAME,
)


class Counted(str):
    """Text that counts how many of its characters are looked at by `find`."""

    looked_at = 0

    def find(self, part: str, start: int = 0, *_: object) -> int:  # type: ignore[override]
        found = super().find(part, start)
        self.looked_at += (len(self) if found < 0 else found + len(part)) - start
        return found


def shape(template: str) -> str:
    return PLACE.sub("{}", template)


def filled(template: str, values: dict[str, str]) -> str:
    return PLACE.sub(lambda place: values[place[1]], template)


SHAPES = {shape(english) for english in catalogue()}


def test_each_sentence_of_the_source_has_german() -> None:
    missing = {template: place for template, place in sentences().items() if shape(template) not in SHAPES}
    assert missing == {}, "add these to the files in agent/language/german"


def test_each_cause_and_each_gate_has_german() -> None:
    causes = {*BY_ERRNO.values(), *BY_SQLITE_CODE.values(), *BY_CERTIFICATE_CODE.values()}
    texts = causes | {IN_THE_LOG, NO_TLS, UNKNOWN_NAME} | {rule.title for rule in GATE_RULES.values()}
    assert texts - set(catalogue()) == set()


def test_each_sentence_of_the_catalogue_is_in_the_source() -> None:
    known = {shape(text) for text in all_texts()} | {shape(words) for words, _ in WORDS.values()}
    composed = json.loads(resources.files("agent.language").joinpath("german", "composed.json").read_text("utf-8"))
    assert {english for english in catalogue().keys() - composed.keys() if shape(english) not in known} == set()


def test_places_agree_and_the_german_is_found() -> None:
    for english, words in catalogue().items():
        places = Counter(PLACE.findall(english))
        assert all(count == 1 for count in places.values()), english
        assert set(places) == set(PLACE.findall(words)), english
        values = {name: f"⟦{number}⟧" for number, name in enumerate(places)}
        assert german(filled(english, values)) == filled(words, values)


@pytest.mark.parametrize(
    ("english", "words"),
    [
        ("no answer within 2.5 s", "Keine Antwort innerhalb von 2,5 s"),
        (
            "connection lost: connection refused (device cnc, link 127.0.0.1:5021). check the adapter",
            "Verbindung verloren: Verbindung abgelehnt (device cnc, link 127.0.0.1:5021). Adapter prüfen",
        ),
        (
            "the mount is not open; the device is not open",
            "Die Aufnahme ist nicht geöffnet; Das Gerät ist nicht geöffnet",
        ),
        (
            "probability of such a scale, at most; a change of ECZ by 16.6 µrad rms between positions 0 and 1 is found "
            "with a probability of 95 %; unnoticed, it would leave 6.5 µm",
            "probability of such a scale, at most; eine Änderung von ECZ um 16,6 µrad (Effektivwert) zwischen den "
            "Positionen 0 und 1 wird mit einer Wahrscheinlichkeit von 95 % gefunden; unbemerkt ließe sie 6,5 µm zurück",
        ),
        ("aborted: Prior (Night)", "abgebrochen: Prior (Night)"),
        ("aborted: abort pressed", "abgebrochen: Abbruch gedrückt"),
        (
            "a sentence that nobody has written in German, 1.5 µm",
            "a sentence that nobody has written in German, 1,5 µm",
        ),
    ],
)
def test_a_text_is_told_in_german_with_its_numbers(english: str, words: str) -> None:
    assert german(english) == words
    assert in_language(english, "en") == english


def test_the_work_for_a_text_grows_with_its_length_alone() -> None:
    """A pattern with several places would try all ways to share out a text that nearly is the sentence."""
    for english, words in catalogue().items():
        sentence = Sentence(english, words)
        text = Counted(sentence.literals[0] + 40 * "".join(sentence.literals[1:]) + "x")
        assert sentence.filled(text) is None or sentence.names
        assert text.looked_at <= len(text), english


def test_a_text_of_many_parts_is_looked_up_a_bounded_number_of_times(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_up, filled_as_it_is = Counter[str](), Sentence.filled
    tried_first = max(catalogue(), key=lambda english: len(shape(english)) - 2 * len(PLACE.findall(english)))

    def counted(sentence: Sentence, text: str) -> Mapping[str, str] | None:
        if sentence.german == catalogue()[tried_first]:
            looked_up[text] += len(text)
        return filled_as_it_is(sentence, text)

    monkeypatch.setattr(Sentence, "filled", counted)
    mixed = "notifications: {} a, b. c; d (e f)"
    for text in (*(one.join(mixed.format(i) for i in range(30)) for one in (". ", ", ")), 60 * "notifications: "):
        looked_up.clear()
        assert german(text)
        assert 0 < looked_up.total() <= 20 * len(text), text[:40]


@pytest.mark.parametrize(
    ("english", "words"),
    [
        ("2026-11-29T03:15:07Z", "29.11.2026 03:15:07Z"),
        ("2026-11-29 03:15 UTC", "29.11.2026 03:15 UTC"),
        ("1.25 ± 0.5 µm (−0.1 to +2.0)", "1,25 ± 0,5 µm (−0,1 to +2,0)"),
        ("/srv/2026-11-29/artefact.toml, backup-2026-11-29.zip, mill-2.5", None),
        ("volcal 0.1.0 at 127.0.0.1:5021, table-1.5.csv, 20261129T031507Z-1f7a", None),
    ],
)
def test_numbers_and_times_are_german_and_names_stay(english: str, words: str | None) -> None:
    assert with_german_numbers(english) == (words or english)


def test_a_record_is_told_in_words_with_units_and_never_by_its_keys() -> None:
    record = {"step": "a/drift", "drift_um": [3.0, 4.0, 0.0], "limit_um": 3, "note": "search wider", "crc32": 17}
    told = record_in_words(record)
    assert told == "search wider; displacement of the first ball 5 µm; limit 3 µm"
    assert german(told) == "weiter suchen; Verschiebung der ersten Kugel 5 µm; Grenze 3 µm"
    assert not re.search(r"[a-z]_[a-z]", told)
