"""Command `python -m campaigns.foreign`, which identifies machines that share nothing with the program."""

from __future__ import annotations

import sys

from campaigns.foreign.trials import main

if __name__ == "__main__":
    sys.exit(main())
