"""Command `python -m campaigns.warming`, which simulates calibrations while machine and ball bar warm up."""

from __future__ import annotations

import sys

from campaigns.warming.trials import main

if __name__ == "__main__":
    sys.exit(main())
