"""Command `python -m campaigns.seasons`, which judges forecasts of the night in which a tolerance is reached."""

from __future__ import annotations

import sys

from campaigns.seasons.judged_forecasts import main

if __name__ == "__main__":
    sys.exit(main())
