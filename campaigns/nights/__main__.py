"""Command `python -m campaigns.nights`, which simulates a season of nightly runs."""

from __future__ import annotations

import sys

from campaigns.nights.play import main

if __name__ == "__main__":
    sys.exit(main())
