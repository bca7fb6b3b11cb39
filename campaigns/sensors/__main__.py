"""Command `python -m campaigns.sensors`, which judges how drifts are explained by temperature sensors."""

from __future__ import annotations

import sys

from campaigns.sensors.judged_sensors import main

if __name__ == "__main__":
    sys.exit(main())
