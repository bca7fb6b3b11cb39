"""OpenAPI document of the HTTP interface. `python -m agent.service.http.description` makes it without a running
service."""

from __future__ import annotations

import json
import sys
from typing import Any

from fastapi import FastAPI

from agent.service.http import problems
from agent.service.http.app import add_endpoints


def openapi_document() -> dict[str, Any]:
    """Return the OpenAPI document. Its version number is fixed, because a release of the program alone does not change
    the interface."""
    app = FastAPI(title="volcal", version="1", summary="Calibration service of one machine.")
    problems.install(app)
    add_endpoints(app)
    return app.openapi()


if __name__ == "__main__":
    json.dump(openapi_document(), sys.stdout, indent=1, sort_keys=True)
    sys.stdout.write("\n")
