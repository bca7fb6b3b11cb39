"""Command `python -m campaigns.features`, which compares predicted errors of features with true ones."""

from __future__ import annotations

import sys

from campaigns.features.trials import main

if __name__ == "__main__":
    sys.exit(main())
