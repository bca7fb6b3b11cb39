"""Verdict on a run: how it ended, as a word, a sentence, a colour and a sign.

Page, list of runs, report, API and command line show the verdicts of this module alone, so that none of them calls a
run complete whose table has failed its proof. The figures of a run have one source as well (`run_figures`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Any, Final

from agent.execution.states import RunState
from agent.results.decision_kinds import CONFIRMED as CONFIRMED_DECISION
from agent.results.decision_kinds import IDENTIFIED, OUTCOME, PROOF


class Look(Enum):
    """Colour and shape of a verdict: green for good, grey for neither, amber if somebody should act, red for bad."""

    GOOD = "done"
    NEUTRAL = "quiet"
    BUSY = "busy"
    WAITING = "held"
    REFUSED = "refused"
    BAD = "fault"


@dataclass(frozen=True)
class RunVerdict:
    """Verdict on a run. `name` is stable and may be used by programs; `word` and `sentence` map each language of the
    page to its text."""

    name: str
    look: Look
    sign: str
    word: Mapping[str, str]
    sentence: Mapping[str, str]

    def as_json(self) -> dict[str, str]:
        """Return the English form as the JSON object that docs/reference/json.md describes."""
        return {
            "name": self.name,
            "look": self.look.value,
            "sign": self.sign,
            "word": self.word["en"],
            "sentence": self.sentence["en"],
        }


def _verdict(name: str, look: Look, sign: str, word: tuple[str, str], sentence: tuple[str, str]) -> RunVerdict:
    return RunVerdict(name, look, sign, *(MappingProxyType({"en": en, "de": de}) for en, de in (word, sentence)))


ACCEPTED = _verdict(
    "accepted",
    Look.GOOD,
    "✔",
    ("Accepted", "Angenommen"),
    (
        "The new table was written, activated and proved by fresh measurements.",
        "Die neue Tabelle wurde geschrieben, aktiviert und durch neue Messungen bestätigt.",
    ),
)
CONFIRMED = _verdict(
    "confirmed",
    Look.GOOD,
    "✔",
    ("Confirmed", "Bestätigt"),
    (
        "The compensation was left as it was: the measurements agree, and a new table was not provably better.",
        "Die Kompensation blieb unverändert: Die Messungen passen zusammen, keine neue Tabelle war nachweisbar besser.",
    ),
)
FUSED = _verdict(
    "fused",
    Look.GOOD,
    "✔",
    ("Fused", "Fusioniert"),
    (
        "The measurements of the night were combined with those of earlier nights; the active table was kept.",
        "Die Messungen der Nacht wurden mit denen früherer Nächte zusammengeführt; die aktive Tabelle blieb.",
    ),
)
WITHIN = _verdict(
    "within-limits",
    Look.GOOD,
    "✔",
    ("Within limits", "Innerhalb der Grenzen"),
    (
        "The machine was found within its limits; nothing was written.",
        "Die Maschine liegt innerhalb ihrer Grenzen; nichts wurde geschrieben.",
    ),
)
OUT = _verdict(
    "out-of-limits",
    Look.REFUSED,
    "!",
    ("Out of limits", "Außerhalb der Grenzen"),
    (
        "The machine was found out of its limits; nothing was written. Calibrate it.",
        "Die Maschine liegt außerhalb ihrer Grenzen; nichts wurde geschrieben. Bitte kalibrieren.",
    ),
)
FULL_NEEDED = _verdict(
    "full-calibration-needed",
    Look.REFUSED,
    "!",
    ("Full calibration needed", "Vollständige Kalibrierung nötig"),
    (
        "The machine has changed more than a night can correct; nothing was written. Calibrate it completely.",
        "Die Maschine hat sich stärker verändert, als eine Nacht korrigieren kann; nichts wurde geschrieben. Bitte "
        "vollständig kalibrieren.",
    ),
)
PROOF_FAILED = _verdict(
    "proof-failed",
    Look.BAD,
    "✘",
    ("Proof failed", "Nachweis misslungen"),
    (
        "The new table failed its proof; the previous compensation was reactivated.",
        "Die neue Tabelle hat den Nachweis nicht bestanden; die vorherige Kompensation wurde wieder aktiviert.",
    ),
)
REFUSED = _verdict(
    "refused",
    Look.REFUSED,
    "!",
    ("Refused", "Abgelehnt"),
    (
        "The run was refused; no table was written, and it left the compensation as it was.",
        "Der Lauf wurde abgelehnt; keine Tabelle wurde geschrieben, die Kompensation blieb unverändert.",
    ),
)
RESTORED = _verdict(
    "restored",
    Look.GOOD,
    "↺",
    ("Restored", "Wiederhergestellt"),
    ("The chosen stored table was restored.", "Die gewählte gespeicherte Tabelle wurde wiederhergestellt."),
)
MEASURED = _verdict(
    "measured",
    Look.NEUTRAL,
    "✔",
    ("Measured", "Gemessen"),
    ("The measurement is complete; nothing was written.", "Die Messung ist beendet; nichts wurde geschrieben."),
)
ABORTED = _verdict(
    "aborted",
    Look.BAD,
    "■",
    ("Aborted", "Abgebrochen"),
    (
        "The run was stopped by a person before its end; no table of it was accepted.",
        "Der Lauf wurde vor seinem Ende angehalten; keine Tabelle daraus wurde angenommen.",
    ),
)
FAULTED = _verdict(
    "faulted",
    Look.BAD,
    "▲",
    ("Fault", "Störung"),
    (
        "An error ended the run; no table of it was accepted.",
        "Ein Fehler hat den Lauf beendet; keine Tabelle daraus wurde angenommen.",
    ),
)
WRITTEN = _verdict(
    "written-not-active",
    Look.WAITING,
    "❚❚",
    ("Written, not active", "Geschrieben, nicht aktiv"),
    (
        "The new table is written but not active and not proved: it waits for the controller.",
        "Die neue Tabelle ist geschrieben, aber weder aktiv noch bestätigt: Sie wartet auf die Steuerung.",
    ),
)
UNFINISHED = _verdict(
    "unfinished",
    Look.WAITING,
    "…",
    ("Unfinished", "Unvollendet"),
    (
        "The run has no end: it was interrupted, unless it is still in progress.",
        "Der Lauf hat kein Ende: Er wurde unterbrochen, sofern er nicht noch läuft.",
    ),
)
RUNNING = _verdict(
    "running",
    Look.BUSY,
    "▶",
    ("In progress", "Läuft"),
    ("The run is in progress.", "Der Lauf ist im Gange."),
)
VERDICTS: Final = (
    *(ACCEPTED, CONFIRMED, FUSED, WITHIN, OUT, FULL_NEEDED, PROOF_FAILED, REFUSED, RESTORED, MEASURED),
    *(ABORTED, FAULTED, WRITTEN, UNFINISHED, RUNNING),
)

_BY_STATE = {
    RunState.ABORTED.value: ABORTED,
    RunState.FAULTED.value: FAULTED,
    RunState.WRITTEN.value: WRITTEN,
}
_TAKEN_BACK = frozenset({RunState.ABORTED.value, RunState.FAULTED.value})
"""States of runs that leave the former table active, whatever the result of their proof."""
_BY_DECISION = {
    "within limits": WITHIN,
    "out of limits": OUT,
    "fused, table kept": FUSED,
    "fused, table written": ACCEPTED,
    "former table restored": PROOF_FAILED,
    "full calibration needed": FULL_NEEDED,
    "full calibration done": CONFIRMED,
    "confirmed": CONFIRMED,
}
"""Verdict for each value of `agent.results.run_outcome.Decision`, whose module is slow to import. A full calibration
that has written a table has a proof, which counts first; without one it has confirmed the active table."""


def verdict_words() -> dict[str, dict[str, str]]:
    """Return the texts of all verdicts as a catalogue of the page: the keys `verdict.NAME` (word) and `verdict.NAME.is`
    (sentence), each with a mapping from language to text."""
    words = {f"verdict.{one.name}": dict(one.word) for one in VERDICTS}
    return words | {f"verdict.{one.name}.is": dict(one.sentence) for one in VERDICTS}


def verdict_of(
    kind: str, state: str, *, ended: bool, accepted: bool | None, decision: str | None, running: bool = False
) -> RunVerdict:
    """Return the verdict on a run of the kind `kind` whose last state is `state` (the text of a `RunState`).

    `accepted` is the result of the proof of a new table, or None without one. `decision` is the decision of a night, a
    verification or a confirmation. `running` is True if the run is known to be in progress.
    """
    if running:
        return RUNNING
    if state in _BY_STATE or not ended:
        return _BY_STATE.get(state, UNFINISHED)
    if state == RunState.REFUSED.value:
        return FULL_NEEDED if decision == "full calibration needed" else REFUSED
    if accepted is not None:
        return ACCEPTED if accepted else PROOF_FAILED
    if decision is None:
        return RESTORED if kind == "restore" else MEASURED
    return _BY_DECISION.get(decision, MEASURED)  # a word that another version of volcal has written


@dataclass(frozen=True)
class RunFigures:
    """Main figures of a run, each None if it is not known. All lengths are in µm.

    `ve_um` is the volumetric error (VE) without a table, and `vce_um` the one that remains with the table that is
    active at the end of the run (VCE); both after removal of the best-fitting rigid motion. `held_out_before_um` is the
    rms residual of the held-out balls with the table from before the run, `held_out_after_um` with the new one.
    `accepted` is the result of the proof of a new table, and `decision` that of a night, verification or confirmation.
    A run that is stopped, or ends with an error, after its proof takes the new table back: `accepted` and
    `held_out_after_um` are None then.
    """

    ve_um: float | None
    vce_um: float | None
    held_out_before_um: float | None
    held_out_after_um: float | None
    accepted: bool | None
    decision: str | None

    def verdict(self, kind: str, state: str, *, ended: bool, running: bool = False) -> RunVerdict:
        """Return the verdict on the run of these figures; the parameters are those of `verdict_of`."""
        return verdict_of(kind, state, ended=ended, accepted=self.accepted, decision=self.decision, running=running)


def run_figures(state: str, decision: Callable[[str], Mapping[str, Any] | None]) -> RunFigures:
    """Return the figures of a run whose last state is `state` (the text of a `RunState`). `decision` returns the
    content of the run's last journaled decision of a kind, or None if there is none."""
    outcome, proof = decision(OUTCOME) or {}, decision(PROOF) or {}
    without_um, new_um = outcome.get("estimated_ve_um"), outcome.get("predicted_vce_um")
    if without_um is None:  # the run has no outcome; the large record is read only then
        volumetric = (decision(IDENTIFIED) or {}).get("volumetric", {})
        without_um, new_um = (volumetric.get(at, {}).get("value_um") for at in ("before_aligned", "after_aligned"))
    night = outcome.get("night") or decision("night") or decision("verify") or {}
    confirmed = outcome.get("confirmed") or {}
    taken_back = state in _TAKEN_BACK
    accepted = None if taken_back else proof.get("accepted")
    kept_um = confirmed.get("ve_kept_um", night.get("ve_now_um"))
    return RunFigures(
        ve_um=without_um,
        vce_um=new_um if accepted else kept_um,
        held_out_before_um=proof.get("before_um", confirmed.get("held_out_um", night.get("held_out_um"))),
        held_out_after_um=None if taken_back else proof.get("after_um"),
        accepted=accepted,
        decision=night.get("decision", CONFIRMED_DECISION if confirmed else None),
    )
