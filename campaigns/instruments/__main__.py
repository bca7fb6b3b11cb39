"""Command `python -m campaigns.instruments`, which compares predictions with a virtual laser and ballbar."""

from __future__ import annotations

import sys

from campaigns.instruments.trials import main

if __name__ == "__main__":
    sys.exit(main())
