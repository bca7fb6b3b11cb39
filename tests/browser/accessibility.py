"""Accessibility rules of axe-core, applied to what a page shows now."""

from __future__ import annotations

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

AXE = Axe()
OFF_BY_DEFAULT = ("label-content-name-mismatch", "target-size", "css-orientation-lock")
OPTIONS = {"resultTypes": ["violations"], "rules": {name: {"enabled": True} for name in OFF_BY_DEFAULT}}


def violations(page: Page) -> list[str]:
    """Each broken rule of WCAG 2.2 AA, or of good practice, with the elements that break it."""
    found = AXE.run(page, options=OPTIONS).response["violations"]
    return [
        f"{rule['id']}: {rule['help']}: {node['html'][:160]} {node['any'][0]['message'] if node['any'] else ''}"
        for rule in found
        for node in rule["nodes"]
    ]
