"""Definition of a bad plan, which the agent must refuse: its mutation of a good plan, its check, and the text that its
refusal must contain.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.planning.case_file import CASE_STUDY
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.runs.kinds.calibrate import preflight_of
from agent.settings.load import load_settings
from campaigns.plans.random_cases import toml
from drivers.errors import VolcalError

Document = dict[str, Any]
GOOD_POSITION = "station,azimuth_deg,elevation_deg\n1,45,0\n"


@dataclass
class CaseFiles:
    """Contents of the files of a good case (one that the agent accepts); a mutation may change them.

    These are the settings, the machine, the artefact, and the text of the position file.
    """

    settings: Document
    machine: Document
    artefact: Document
    positions: str = GOOD_POSITION


Change = Callable[[CaseFiles], None]


@dataclass(frozen=True)
class BadPlan:
    """One bad plan and the refusal, an error, that it must cause.

    `change` modifies the files of a good case. `error` is the type of the refusal, `words` are texts that its message
    must contain, and `where` gives the locations that the refusal must name, such as a step. The function `preflight`
    is called after the files have been accepted; by default it simulates the procedure without changes, and another
    function may change the steps.
    """

    name: str
    change: Change
    error: type[VolcalError]
    words: tuple[str, ...] = ()
    where: Mapping[str, str] | None = None
    preflight: Callable[[Job], object] = preflight_of

    def complaint(self, directory: Path) -> str:
        """Check this plan with files in `directory`, and return an empty string if it is refused for the right reason.

        Otherwise the returned text describes what happened instead.
        """
        try:
            check_case(self.change, directory, self.preflight)
        except VolcalError as refusal:
            return self._wrong(refusal)
        except Exception as defect:  # noqa: BLE001  a traceback is never the right refusal
            return f"traceback: {defect!r}"
        return "it passed"

    def _wrong(self, refusal: VolcalError) -> str:
        text = str(refusal)
        if type(refusal) is not self.error:
            return f"{type(refusal).__name__}, expected {self.error.__name__}: {text}"
        missing = [word for word in self.words if word not in text]
        missing += [f"{k} {v}" for k, v in (self.where or {}).items() if not refusal.where.get(k, "").startswith(v)]
        return f"does not say {missing}: {text}" if missing else ""


def good_case(directory: Path) -> CaseFiles:
    """Return the files of a good case, which the agent accepts.

    The case has one measured and one held-out position at the first station of the case study. It has no probe check,
    no qualification and no reversal test.
    """
    settings = tomllib.loads(CASE_STUDY.read_text())
    machine = CASE_STUDY.parent / settings["machine"]
    artefact = CASE_STUDY.parent / settings["artefact"]
    settings |= {"machine": "machine.toml", "artefact": "artefact.toml", "state_directory": "state"}
    settings["stations"]["standing_at"] = 1
    settings["procedure"] = {"position_set": "positions.csv", "stations": [1]}
    settings["verification"] = {"positions_deg": [[20.0, 25.0]], "stations": [1]}
    settings["probe_check"] = {"enabled": False}
    settings["qualification"] = {"enabled": False}
    settings["reversal"] = {"enabled": False}
    described = tomllib.loads(machine.read_text())
    del described["deflection"]
    return CaseFiles(settings, described, tomllib.loads(artefact.read_text()))


def check_case(change: Change, directory: Path, preflight: Callable[[Job], object]) -> None:
    """Apply `change` to the files of a good case, check the case in the same way as `volcal config check`, and run the
    function `preflight`, which simulates the procedure.

    Raises the error with which the check or the preflight refuses the case.
    """
    files = good_case(directory)
    change(files)
    for name in ("machine", "artefact"):
        (directory / f"{name}.toml").write_text(toml(getattr(files, name)))
    (directory / "positions.csv").write_text(files.positions)
    (directory / "settings.toml").write_text(toml(files.settings))
    job = prepare_job(load_settings(directory / "settings.toml"), directory)
    preflight(job)


def unchanged(_: CaseFiles) -> None:
    """Leave the files of the case unchanged. The function is used for bad plans in which only the steps are wrong."""


def setting(path: str, value: object) -> Change:
    """Return a change (a function that modifies the files of a case) that sets the settings key at `path` to
    `value`.
    """
    return lambda files: set_key(files.settings, path, value)


def machine(path: str, value: object) -> Change:
    return lambda files: set_key(files.machine, path, value)


def artefact(path: str, value: object) -> Change:
    return lambda files: set_key(files.artefact, path, value)


def positions(*rows: str) -> Change:
    """Return a change (a function that modifies the files of a case) that replaces all rows below the header of the
    position file with `rows`.
    """

    def change(files: CaseFiles) -> None:
        files.positions = "\n".join(["station,azimuth_deg,elevation_deg", *rows]) + "\n"

    return change


def set_key(document: Document, path: str, value: object) -> None:
    """Set to `value` the key of `document` at a path such as ``stations.places_mm.0.1``. Missing sections are
    created.
    """
    *parents, last = path.split(".")
    place: Any = document
    for name in parents:
        place = place[int(name)] if isinstance(place, list) else place.setdefault(name, {})
    if isinstance(place, list):
        place[int(last)] = value
    else:
        place[last] = value
