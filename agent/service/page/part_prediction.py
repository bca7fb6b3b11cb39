"""Prediction of the errors of a part for the page, from the estimate of a run in the journal."""

from __future__ import annotations

from http import HTTPStatus
from math import radians
from pathlib import Path
from threading import Lock
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from agent.execution.run_record import RunRecord, read_record
from agent.files import translated
from agent.results.decision_kinds import INPUTS
from agent.results.table_image import table_of
from agent.runs.kinds.restoration import stored_table
from agent.service.http.models import RequestBody
from agent.service.http.problems import RequestRefused
from agent.workpiece.estimate_and_table import EstimateAndTable
from agent.workpiece.predicted_features import WantedPlace, predict_text
from drivers.errors import InputError
from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.formats.estimate_file import parse_estimate

Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
LONGEST_FILE = 60_000
"""Characters of a feature file, about 600 features."""


class PartBody(RequestBody):
    """Part to be predicted: the name and the text of its feature file, and its place.

    `origin_mm` is the place of its origin in the coordinates of the machine, or null for the best place on the table at
    the height `height_mm`.
    """

    file: str = Field(min_length=1, max_length=200)
    features: str = Field(max_length=LONGEST_FILE)
    origin_mm: tuple[Coordinate, Coordinate, Coordinate] | None = None
    height_mm: Coordinate = 0.0
    turned_deg: float = Field(default=0.0, ge=-360.0, le=360.0)


class PartPredictions:
    """Predictions for the page. One is made at a time, since a map of places takes seconds of the processor; the lock
    `busy` is held meanwhile."""

    def __init__(self) -> None:
        self.busy = Lock()

    def document(self, directory: Path, run_id: str, part: PartBody) -> dict[str, Any]:
        """Return the predicted errors of the part, with the map of the places on the table.

        They are predicted without a table, and with the table that was active after the run, if there was one. Raises
        InputError, which names the row and column, if the part is invalid or cannot be reached where it stands, or if
        the run has no estimate, and RequestRefused while another prediction is made.
        """
        if not self.busy.acquire(blocking=False):
            detail = "another prediction is being made"
            raise RequestRefused(
                HTTPStatus.TOO_MANY_REQUESTS, detail, "try again in a few seconds", {"Retry-After": "5"}
            )
        try:
            known = _known(directory, read_record(directory, run_id))
            place = WantedPlace(part.origin_mm, part.height_mm, radians(part.turned_deg), with_map=True)
            return predict_text(part.features, part.file, known, place).as_json()
        finally:
            self.busy.release()


def _known(directory: Path, record: RunRecord) -> EstimateAndTable:
    inputs = record.decision(INPUTS)
    if record.estimate is None or inputs is None:
        raise InputError(f"run {record.run_id} has no estimate", hint="the run ended before the errors were identified")
    with translated():
        estimate = parse_estimate(record.estimate, f"estimate of run {record.run_id}")
    offset = np.array(inputs["tools_mm"][record.settings["tool"]])
    role, table = _table_after(directory, record, offset)
    return EstimateAndTable(estimate, table, role, offset)


def _table_after(directory: Path, record: RunRecord, offset_mm: Array) -> tuple[str | None, CompensationTable | None]:
    """Return the role and the table that was active after the run: its own one, or else the one that it found."""
    accepted = record.decision("accepted") is not None
    role = "staged" if accepted and record.table("staged") is not None else "backup"
    image = None if record.table(role) is None else stored_table(directory, record.run_id, role)
    return (None, None) if image is None else (role, table_of(image, offset_mm))
