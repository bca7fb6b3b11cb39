"""List of the alarms of all runs and of those that arose between runs, read from the journal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agent.errors import JournalFailed
from agent.execution.journal_reader import has_journal, open_journal
from agent.execution.journal_rows import AlarmRow
from agent.service.alarms import CODES, journaled_alarm, recorded_alarm
from agent.service.control import Alarm
from drivers.errors import VolcalError


@dataclass(frozen=True)
class ListedAlarm:
    """Alarm of the run `run_id`, open from the UTC time `since` to `until`. `until` is None if the end is not recorded:
    the alarm may be open still. `run_id` and `kind` are empty if the alarm arose between runs."""

    since: str
    until: str | None
    run_id: str
    kind: str
    alarm: Alarm


@dataclass(frozen=True)
class AlarmPage:
    """Page of the alarms, the latest first, and the number of all alarms."""

    alarms: Sequence[ListedAlarm]
    total: int


def alarm_page(directory: Path, limit: int, offset: int) -> AlarmPage:
    """Return at most `limit` alarms without the first `offset` ones, the latest first. Raise JournalFailed if the
    journal in the state directory `directory` cannot be read."""
    if not has_journal(directory):
        return AlarmPage((), 0)
    with open_journal(directory, JournalFailed) as reader:
        return AlarmPage([_listed(row) for row in reader.alarms(limit, offset)], reader.count_alarms())


def _listed(row: AlarmRow) -> ListedAlarm:
    unknown = CODES[VolcalError]
    if row.kind == "fault":
        alarm = journaled_alarm(row.record, unknown)
    else:
        alarm = recorded_alarm(row.record) or Alarm(unknown.code, unknown.text, unknown.hint)
    return ListedAlarm(row.at, row.until, row.run_id, row.run_kind, alarm)
