"""Notice that a receiver gets, and its JSON form (docs/reference/json.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator

from twin.formats.toml_reading import StrictModel

VERSION: Final = 1
Severity = Literal["info", "warning", "alarm"]
Occasion = Literal["alarm", "end", "question", "not-started", "started", "state", "test"]


@dataclass(frozen=True)
class NoticeAlarm:
    """Alarm in a notice, in the language of the notice. `code` is its number (docs/reference/alarms.md), `meaning` and
    `remedy` are its general texts, and `text` and `hint` are those of this very error."""

    code: int
    meaning: str
    remedy: str
    text: str
    hint: str
    where: Mapping[str, str]


@dataclass(frozen=True)
class NoticeRun:
    """Run in a notice. The times are UTC; `ended` and all figures are None if they are not known.

    `ve_um` and `vce_um` are the volumetric errors in µm without a table (VE) and with the one that is active at the end
    (VCE); `held_out_before_um` and `held_out_after_um` are the rms residuals in µm of the held-out balls with the
    former and with the new table. `verdict` is the stable name of the verdict, `verdict_text` its sentence in the
    language of the notice. `report` is the URL of the report.
    """

    run_id: str
    kind: str
    started: str | None = None
    ended: str | None = None
    verdict: str | None = None
    verdict_text: str | None = None
    machine_minutes: float | None = None
    ve_um: float | None = None
    vce_um: float | None = None
    held_out_before_um: float | None = None
    held_out_after_um: float | None = None
    report: str | None = None


@dataclass(frozen=True)
class Notice:
    """Notice for people and programs. A notice may arrive more than once; its `notice_id` is the same each time.

    `at` is the UTC time of the occasion, `state` the state of the service. `subject` and `text` say everything in the
    words of the chosen language.
    """

    notice_id: str
    at: str
    machine: str
    occasion: Occasion
    severity: Severity
    state: str
    subject: str
    text: str
    alarms: tuple[NoticeAlarm, ...] = ()
    run: NoticeRun | None = None

    def as_json(self) -> dict[str, Any]:
        document = asdict(self)
        return {"version": VERSION, **document, "alarms": list(document["alarms"])}


def _instant(text: str) -> str:
    """Return the text of an instant. Raises ValueError if it is none, or has no time zone to compare it in."""
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("the instant has no time zone")
    return text


class StoredNotice(StrictModel):
    """Form in which a notice is stored, to validate what is read from the disk."""

    version: Literal[1]
    notice_id: str
    at: Annotated[str, AfterValidator(_instant)]
    machine: str
    occasion: Occasion
    severity: Severity
    state: str
    subject: str
    text: str
    alarms: tuple[NoticeAlarm, ...]
    run: NoticeRun | None

    def notice(self) -> Notice:
        return Notice(**{name: getattr(self, name) for name in Notice.__dataclass_fields__})
