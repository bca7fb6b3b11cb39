"""Command `python -m campaigns.resume`, which interrupts and resumes a run at each of its steps."""

from __future__ import annotations

from campaigns.resume.trials import main

if __name__ == "__main__":
    main()
