"""Command `python -m campaigns.resume`."""

from __future__ import annotations

from campaigns.resume.trials import main

if __name__ == "__main__":
    main()
