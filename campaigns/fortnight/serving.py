"""Command `volcal serve` with the simulated calendar of the fortnight and otherwise without changes.

python -m campaigns.fortnight.serving SETTINGS CALENDAR
"""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

from agent.service.daemon.logs import log_as_json
from agent.service.daemon.serve import serve
from campaigns.fortnight.simulated_calendar import SimulatedCalendar


def main() -> None:
    config, calendar = map(Path, sys.argv[1:])
    calendar_ = SimulatedCalendar(calendar)
    calendar_.install()
    log_as_json(logging.INFO)
    serve(config, calendar_.circumstances)


if __name__ == "__main__":
    main()
