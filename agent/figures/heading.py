"""Line that heads every printed result and every figure. It stands apart from the drawing libraries, which commands
that only print do not need.
"""

from __future__ import annotations


def subject(machine: str, artefact: str) -> str:
    """Return the line that names the machine and the artefact for which a result holds."""
    return f"machine {machine}, artefact {artefact}"
