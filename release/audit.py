"""Command `make audit`: every installed package is pinned, every pin is needed, and every licence is allowed.

    python -m release.audit

Prints one line for each finding. The exit code is 0 only if there is none.
"""

from __future__ import annotations

import sys

from release.errors import ReleaseRefused
from release.licences import audit_licences, read_licence_list
from release.packages import ROOT, SHIPPED_EXTRAS, Installed, installed_packages, project_table, reached, required
from release.pins import CONSTRAINTS, audit_pins


def findings(installed: Installed) -> list[str]:
    """Return what is wrong with the pins and licences of the installed packages, one sentence for each finding."""
    project = project_table()
    try:
        shipped = reached(required(project, SHIPPED_EXTRAS), installed)
    except ReleaseRefused as error:
        return [str(error)]
    constraints = (ROOT / CONSTRAINTS).read_text(encoding="utf-8")
    return [*audit_pins(project, constraints, installed), *audit_licences(installed, shipped, read_licence_list())]


def main() -> int:
    installed = installed_packages()
    found = findings(installed)
    for text in found:
        print(text, file=sys.stderr)
    if not found:
        print(f"{len(installed)} packages: each pinned, each under an allowed licence")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
