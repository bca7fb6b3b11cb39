"""Line that heads every printed result and every figure. It is in a module of its own, because commands that only print
do not need the drawing libraries.
"""

from __future__ import annotations


def subject(machine: str, artefact: str) -> str:
    """Return the line that names the machine and the artefact for which a result holds."""
    return f"machine {machine}, artefact {artefact}"
