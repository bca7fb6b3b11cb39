"""Alarms that arise between runs, kept in the journal: no run has them, so they have rows of their own.

They are kept for the list of alarms, and so that an alarm has its number and cause after a restart of the service. An
alarm that cannot be kept is shown all the same.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import structlog

from agent.errors import JournalFailed
from agent.execution.journal import Journal
from agent.execution.journal_reader import has_journal, open_journal
from agent.service.alarms import recorded_alarm
from agent.service.control import Alarm
from drivers.errors import VolcalError

log = structlog.get_logger()
ENDPOINT: Final = "endpoint"
"""Place of the alarm of an endpoint that is not open. Each start of the service tries anew to open it."""


def alarm_record(alarm: Alarm) -> dict[str, Any]:
    """Return the record of an alarm in the journal, which `agent.service.alarms.recorded_alarm` reads."""
    return {**vars(alarm), "where": dict(alarm.where)}


@dataclass(frozen=True)
class IdleAlarms:
    """Alarms between runs in the journal of the state directory `directory`. Errors of the journal are logged."""

    directory: Path

    def keep(self, alarm: Alarm) -> None:
        """Record that an alarm arose now."""
        try:
            with closing(Journal(self.directory)) as journal:
                journal.begin_idle_alarm(alarm_record(alarm))
        except VolcalError as error:
            log.warning("an alarm between runs is not recorded", code=alarm.code, reason=str(error))

    def end(self, alarms: Collection[Alarm]) -> None:
        """Record that these alarms have ended; those that were never kept do not matter."""
        try:
            if alarms and has_journal(self.directory):
                with closing(Journal(self.directory)) as journal:
                    journal.end_idle_alarms([alarm_record(alarm) for alarm in alarms])
        except VolcalError as error:
            log.warning("the end of an alarm between runs is not recorded", reason=str(error))

    def left_open(self) -> tuple[Alarm, ...]:
        """Return the alarms that were open when the service ended, the first one first. That of an endpoint has ended
        with the service."""
        try:
            found = [alarm for record in self._open_records() if (alarm := recorded_alarm(record)) is not None]
        except VolcalError as error:
            log.warning("alarms of before the start of the service are not known", reason=str(error))
            return ()
        self.end([alarm for alarm in found if ENDPOINT in alarm.where])
        return tuple(alarm for alarm in found if ENDPOINT not in alarm.where)

    def _open_records(self) -> list[Mapping[str, Any]]:
        if not has_journal(self.directory):
            return []
        with open_journal(self.directory, JournalFailed) as reader:
            return [row.record for row in reader.open_idle_alarms()]
