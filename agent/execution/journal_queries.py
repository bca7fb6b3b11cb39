"""SQL statements used by the reader of the journal, the database of all runs.

Each statement selects the columns of one row type in the order of the fields of that type.

The statements are in a module of their own, apart from the reader, so that a change of the database tables affects only
this module and `journal_schema.sql`. A list of kinds of rows, such as kinds of events, is passed as one JSON parameter;
every statement is therefore constant. The reader replaces some texts in braces:

- `{aside}` by a condition that excludes rows that are not part of the procedure of a run, or by an empty text,
- `{at}` by the beginning of the names of the tables that hold the steps, balls and temperatures of a run: empty, or
  that of the temporary tables into which a compacted run is unpacked,
- `{compacted}` by the table of compacted runs, or by an empty one if the journal has none.
"""

# ruff: noqa: S608  every statement is put together from constants of this module

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

RUN = "SELECT run, run_id, kind, started, ended, state, reason, software FROM runs "
COUNTS = (
    "SELECT run, run_id, kind, started, ended, state, reason, software, "
    "coalesce(packed.balls, (SELECT count(*) FROM balls WHERE balls.run = runs.run)), coalesce(packed.touches, "
    "(SELECT count(*) FROM steps WHERE steps.run = runs.run AND kind = 'TouchTowards' AND result IS NOT NULL)) "
    "FROM runs LEFT JOIN {compacted} AS packed USING (run) "
)
BEGUN_RUNS = RUN + (
    "WHERE EXISTS (SELECT 1 FROM steps WHERE steps.run = runs.run) "
    "OR EXISTS (SELECT 1 FROM {compacted} AS packed WHERE packed.run = runs.run) "
    "OR EXISTS (SELECT 1 FROM origins WHERE origins.run = runs.run AND begun_s IS NOT NULL) "
    "ORDER BY run DESC"
)
STARTED_RUNS = (  # a resumed run that began before the last one has a lower number, and is later
    "SELECT runs.run, run_id, runs.kind, started, ended, runs.state, reason, software FROM events "
    "CROSS JOIN runs USING (run) WHERE events.kind = 'state' AND CASE WHEN json_valid(record) "
    "THEN json_extract(record, '$.state') END IN ('preflight', 'resuming') ORDER BY events.rowid DESC"
)
ADDED_AFTER_END = (  # every run writes its outcome just after its end
    "SELECT run FROM decisions JOIN runs USING (run) WHERE at > ended AND decisions.kind <> 'outcome' "
    "UNION SELECT run FROM tables JOIN runs USING (run) WHERE at > ended"
)
HAS_STEP = "SELECT 1 FROM {at}steps WHERE run = :run AND kind IN (SELECT value FROM json_each(:kinds)) LIMIT 1"
HAS_STEP_BELOW = "SELECT 1 FROM {at}steps WHERE run = :run AND substr(key, 1, length(:start)) = :start LIMIT 1"
ORIGIN = "SELECT run, run_id, settings, record, begun_s, begun_at FROM runs JOIN origins USING (run) WHERE run = :run"
STEP = "SELECT ordinal, key, kind, detail, begun, finished, result, error FROM {at}steps "
TOUCH = "FROM {at}steps WHERE run = :run AND kind = 'TouchTowards' AND result IS NOT NULL AND NOT aside "
TEMPERATURE = (
    "SELECT (finished - (SELECT min(begun) FROM {at}steps WHERE run = :run)) / 60.0, reading.record "
    "FROM {at}temperatures AS reading JOIN {at}steps USING (run, ordinal) WHERE run = :run "
    "AND reading.key NOT IN (SELECT json_extract(record, '$.rejected') FROM events WHERE run = :run "
    "AND kind = 'event' AND json_extract(record, '$.rejected') IS NOT NULL) ORDER BY ordinal"
)
DECISION = "SELECT run, run_id, decisions.rowid, at, decisions.kind, record FROM decisions JOIN runs USING (run) "
TABLE = (
    "SELECT run, run_id, tables.rowid, at, role, bank, crc32, origin_mm, step_mm, resolution_mm, shape "
    "FROM tables JOIN runs USING (run) "
)
LAST_BACKUP = TABLE + (  # a resumed run that began before the last one has a lower number, and is later
    "WHERE role = 'backup' AND run = coalesce(:run, (SELECT run FROM events WHERE events.kind = 'state' "
    "AND CASE WHEN json_valid(record) THEN json_extract(record, '$.state') END IN ('preflight', 'resuming') "
    "AND EXISTS (SELECT 1 FROM tables AS kept WHERE kept.run = events.run AND kept.role = 'backup') "
    "ORDER BY events.rowid DESC LIMIT 1), (SELECT max(run) FROM tables WHERE role = 'backup')) LIMIT 1"
)
EVENT = (
    "SELECT rowid, at, kind, record FROM events WHERE run = :run AND rowid > :after "
    "AND (:kinds IS NULL OR kind IN (SELECT value FROM json_each(:kinds))){aside} ORDER BY rowid LIMIT :limit"
)
_ALARMS = (  # SQLite takes the other columns from the row with the largest number
    "WITH listed (number, run, at, kind, record) AS (SELECT rowid, run, at, kind, record FROM events "
    "WHERE kind = 'alarm' UNION ALL SELECT max(fault.rowid), fault.run, fault.at, fault.kind, fault.record "
    "FROM events AS fault JOIN runs USING (run) WHERE fault.kind = 'fault' AND state IN ('faulted', 'aborted') "
    "AND NOT EXISTS (SELECT 1 FROM events WHERE events.run = fault.run AND kind = 'alarm') GROUP BY fault.run), "
    "closed AS (SELECT listed.*, (SELECT min(at) FROM events WHERE events.run = listed.run "
    "AND events.rowid > listed.number AND (kind = 'acknowledged' OR (kind = 'state' AND listed.kind = 'alarm'))) "
    "AS settled, (SELECT started FROM runs WHERE runs.run > listed.run ORDER BY runs.run LIMIT 1) AS followed "
    "FROM listed), shown (run_id, run_kind, number, at, until, kind, record) AS (SELECT run_id, runs.kind, "
    "closed.number, at, min(coalesce(settled, followed), coalesce(followed, settled)), closed.kind, record "
    "FROM closed JOIN runs USING (run) UNION ALL SELECT '', '', number, at, until, 'alarm', record FROM {idle}) "
)
ALARM = _ALARMS + "SELECT * FROM shown ORDER BY at DESC, run_id = '', number DESC LIMIT :limit OFFSET :offset"
ALARM_COUNT = _ALARMS + "SELECT count(*) FROM shown"
IDLE_ALARMS = "idle_alarms"
NO_IDLE_ALARMS = "(SELECT NULL AS number, NULL AS at, NULL AS until, NULL AS record WHERE 0)"
OPEN_IDLE_ALARM = "SELECT '', '', number, at, until, 'alarm', record FROM {idle} WHERE until IS NULL ORDER BY number"
COMPACTED = "compacted_runs"
NONE_COMPACTED = "(SELECT NULL AS run, NULL AS balls, NULL AS touches, NULL AS content WHERE 0)"
CONTENT = "SELECT content FROM {compacted} WHERE run = :run"
UNPACKED = "temp.unpacked_"
UNPACKED_TABLES = (
    "PRAGMA temp_store = MEMORY",  # reading a run needs no space on the disk
    "CREATE TEMP TABLE IF NOT EXISTS unpacked_runs (run INTEGER)",
    *(
        f"CREATE TEMP TABLE IF NOT EXISTS unpacked_{table} AS SELECT * FROM main.{table} WHERE 0"
        for table in ("steps", "balls", "temperatures")
    ),
)
"""Statements that create the temporary tables into which one compacted run at a time is unpacked."""
PACKED_COLUMNS: Final[Mapping[str, str]] = {
    "steps": "ordinal, key, kind, detail, begun, finished, result, error, aside",
    "balls": "ordinal, key, record",
    "temperatures": "ordinal, key, record",
}
"""Columns, apart from the run, of the tables whose rows a compacted run has in packed form."""
IMAGE = "SELECT origin_mm, step_mm, resolution_mm, shape, counts FROM tables WHERE "
