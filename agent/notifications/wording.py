"""Subjects and texts of notices, in English and German."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from typing import Final

from agent.language.sentences import Language
from agent.notifications.notice import Notice, NoticeAlarm, NoticeRun
from drivers.clock import utc_timestamp

WORDS: Final[dict[str, dict[Language, str]]] = {
    "alarm": {"en": "alarm {code}: {meaning}", "de": "Alarm {code}: {meaning}"},
    "end": {"en": "{kind}: {verdict}", "de": "{kind}: {verdict}"},
    "question": {"en": "a run waits for an answer", "de": "ein Lauf wartet auf eine Antwort"},
    "not-started": {"en": "{kind} was not started", "de": "{kind} wurde nicht gestartet"},
    "started": {"en": "{kind} started", "de": "{kind} gestartet"},
    "test": {"en": "test of the notifications", "de": "Test der Benachrichtigungen"},
    "test.text": {
        "en": "This is a test. Nothing has happened at the machine.",
        "de": "Dies ist ein Test. An der Maschine ist nichts geschehen.",
    },
    "machine": {"en": "Machine", "de": "Maschine"},
    "run": {"en": "Run", "de": "Lauf"},
    "alarm.word": {"en": "Alarm", "de": "Alarm"},
    "cause": {"en": "Cause", "de": "Ursache"},
    "place": {"en": "Place", "de": "Ort"},
    "remedy": {"en": "Remedy", "de": "Abhilfe"},
    "hint": {"en": "Hint", "de": "Hinweis"},
    "minutes": {"en": "Machine time", "de": "Maschinenzeit"},
    "ve": {"en": "VE without table", "de": "VE ohne Tabelle"},
    "vce": {"en": "VCE with table", "de": "VCE mit Tabelle"},
    "held_out": {"en": "Held-out balls", "de": "Kontrollkugeln"},
    "before_after": {"en": "{before} before, {after} after", "de": "{before} vorher, {after} nachher"},
    "report": {"en": "Report", "de": "Bericht"},
    "kind.calibrate": {"en": "Calibration", "de": "Kalibrierung"},
    "kind.nightly": {"en": "Night run", "de": "Nachtlauf"},
    "kind.verify": {"en": "Verification", "de": "Verifizierung"},
    "kind.try": {"en": "Trial of one ball", "de": "Probemessung einer Kugel"},
    "kind.restore": {"en": "Restoration of a table", "de": "Wiederherstellung einer Tabelle"},
}


def word(key: str, language: Language, **values: str) -> str:
    return WORDS[key][language].format(**values)


def kind_word(kind: str, language: Language) -> str:
    """Return the name of a kind of run; a kind without a word is named as it is."""
    return WORDS.get(f"kind.{kind}", {}).get(language, kind)


def facts(
    machine: str, language: Language, alarms: Sequence[NoticeAlarm], run: NoticeRun | None, opening: str = ""
) -> str:
    """Return the text of a notice: the sentence `opening`, then one fact in each line."""
    lines = [f"{word('machine', language)}: {machine}"]
    if run is not None:
        lines += _run_lines(run, language)
    for alarm in alarms:
        lines += ["", *_alarm_lines(alarm, language)]
    return "\n".join([*([opening, ""] if opening else []), *lines, ""])


def trial_notice(machine: str, language: Language) -> Notice:
    """Return a notice that says that it is a test."""
    return Notice(
        notice_id=str(uuid.uuid4()),
        at=utc_timestamp(),
        machine=machine,
        occasion="test",
        severity="info",
        state="idle",
        subject=f"{machine}: {word('test', language)}",
        text=facts(machine, language, (), None, word("test.text", language)),
    )


def _run_lines(run: NoticeRun, language: Language) -> Iterator[str]:
    yield f"{word('run', language)}: {run.run_id}, {kind_word(run.kind, language)}"
    if run.machine_minutes is not None:
        yield f"{word('minutes', language)}: {_figure(run.machine_minutes, language, 1)} min"
    for key, value_um in (("ve", run.ve_um), ("vce", run.vce_um)):
        if value_um is not None:
            yield f"{word(key, language)}: {_figure(value_um, language)} µm"
    if run.held_out_before_um is not None:
        before = f"{_figure(run.held_out_before_um, language)} µm"
        if run.held_out_after_um is not None:
            after = f"{_figure(run.held_out_after_um, language)} µm"
            before = word("before_after", language, before=before, after=after)
        yield f"{word('held_out', language)}: {before}"
    if run.report is not None:
        yield f"{word('report', language)}: {run.report}"


def _alarm_lines(alarm: NoticeAlarm, language: Language) -> Iterator[str]:
    yield f"{word('alarm.word', language)} {alarm.code}: {alarm.meaning}"
    yield f"{word('cause', language)}: {alarm.text}"
    if alarm.where:
        yield f"{word('place', language)}: {', '.join(f'{name} {place}' for name, place in alarm.where.items())}"
    yield f"{word('remedy', language)}: {alarm.remedy}"
    if alarm.hint:
        yield f"{word('hint', language)}: {alarm.hint}"


def _figure(value: float, language: Language, digits: int = 2) -> str:
    text = f"{value:.{digits}f}"
    return text.replace(".", ",") if language == "de" else text
