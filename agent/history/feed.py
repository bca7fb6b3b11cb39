"""Update of the history database after a run.

`update_history` writes logs. It is therefore separate from `agent.history.sync`, which does not write logs.
"""

from __future__ import annotations

from contextlib import closing

import structlog

from agent.history.database_url import database_address
from agent.history.store import HistoryStore
from agent.history.sync import RunsLeftOut, sync_ends
from agent.settings.schema import Settings
from drivers.errors import LinkLost, VolcalError

log = structlog.get_logger()

UNREACHED = "its database cannot be reached. No data are lost: `volcal history sync` copies the run later"
"""Text in place of what the database said, which is in the log."""


def update_history(settings: Settings, run_id: str) -> str:
    """Add the run `run_id`, and all other runs of the journal that are missing, to the history database. Runs whose end
    is stored are not read again, so the work does not grow with the number of runs.

    Return an empty text on success. If the database cannot be updated, or if runs cannot be read and only the others
    are stored, log the error and return its text; the run is not affected.
    """
    try:
        with closing(HistoryStore(database_address(settings))) as store:
            written = sync_ends(settings.state_directory, store)
    except RunsLeftOut as error:
        log.warning("history not complete", run=run_id, reason=str(error))
        return f"the history is not complete: {error}"
    except VolcalError as error:
        log.warning("history not updated", run=run_id, reason=str(error))
        return f"the history was not updated: {UNREACHED if isinstance(error, LinkLost) else error}"
    log.info("history updated", run=run_id, runs=len(written))
    return ""
