"""`volcal serve` with the calendar of the fortnight; nothing else in it is another one.

python -m campaigns.fortnight.serving SETTINGS CALENDAR
"""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # said before numpy is first imported

from agent.service.daemon.logs import log_as_json
from agent.service.daemon.serve import serve
from campaigns.fortnight.almanac import Almanac


def main() -> None:
    config, calendar = map(Path, sys.argv[1:])
    almanac = Almanac(calendar)
    almanac.rule()
    log_as_json(logging.INFO)
    serve(config, almanac.circumstances)


if __name__ == "__main__":
    main()
