"""One bad plan: what is wrong with it, how it is tried, and what its refusal must say."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.planning.case_file import CASE_STUDY
from agent.planning.job import Job, prepare_job
from agent.planning.preflight import run_preflight
from agent.settings.load import load_settings
from campaigns.plans.drawing import toml
from drivers.errors import VolcalError

Document = dict[str, Any]
GOOD_POSITION = "station,azimuth_deg,elevation_deg\n1,45,0\n"


@dataclass
class Files:
    """A good case as documents that a mutation may change: settings, machine, artefact, and the text of positions."""

    settings: Document
    machine: Document
    artefact: Document
    positions: str = GOOD_POSITION


Change = Callable[[Files], None]


@dataclass(frozen=True)
class Bad:
    """`error`: type of the refusal; `words`: each in its text; `where`: named places that it must give.

    `preflight`: preflight run once its files have passed; by default of the unchanged procedure.
    """

    name: str
    change: Change
    error: type[VolcalError]
    words: tuple[str, ...] = ()
    where: Mapping[str, str] | None = None
    preflight: Callable[[Job], object] = run_preflight

    def complaint(self, directory: Path) -> str:
        """Empty where the plan is refused for the right reason; else what happened instead."""
        try:
            prepared(self.change, directory, self.preflight)
        except VolcalError as refusal:
            return self._wrong(refusal)
        except Exception as defect:  # noqa: BLE001  a traceback is never the right refusal
            return f"traceback: {defect!r}"
        return "it passed"

    def _wrong(self, refusal: VolcalError) -> str:
        text = str(refusal)
        if type(refusal) is not self.error:
            return f"{type(refusal).__name__}, wanted {self.error.__name__}: {text}"
        missing = [word for word in self.words if word not in text]
        missing += [f"{k} {v}" for k, v in (self.where or {}).items() if not refusal.where.get(k, "").startswith(v)]
        return f"does not say {missing}: {text}" if missing else ""


def good(directory: Path) -> Files:
    """One position and one held out at the first station of the case study, without a look at the probe before."""
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
    return Files(settings, described, tomllib.loads(artefact.read_text()))


def prepared(change: Change, directory: Path, preflight: Callable[[Job], object]) -> None:
    """Everything that `volcal config check` and the preflight do with a changed case. Raises their refusal."""
    files = good(directory)
    change(files)
    for name in ("machine", "artefact"):
        (directory / f"{name}.toml").write_text(toml(getattr(files, name)))
    (directory / "positions.csv").write_text(files.positions)
    (directory / "settings.toml").write_text(toml(files.settings))
    job = prepare_job(load_settings(directory / "settings.toml"), directory)
    preflight(job)


def unchanged(_: Files) -> None:
    """The files are good; it is the steps that are not."""


def setting(path: str, value: object) -> Change:
    """One key of the settings, by its path."""
    return lambda files: put(files.settings, path, value)


def machine(path: str, value: object) -> Change:
    return lambda files: put(files.machine, path, value)


def artefact(path: str, value: object) -> Change:
    return lambda files: put(files.artefact, path, value)


def positions(*rows: str) -> Change:
    """The rows of the position file below its header."""

    def change(files: Files) -> None:
        files.positions = "\n".join(["station,azimuth_deg,elevation_deg", *rows]) + "\n"

    return change


def put(document: Document, path: str, value: object) -> None:
    """Set the key at a path such as ``stations.places_mm.0.1``; sections that are missing are made."""
    *parents, last = path.split(".")
    place: Any = document
    for name in parents:
        place = place[int(name)] if isinstance(place, list) else place.setdefault(name, {})
    if isinstance(place, list):
        place[int(last)] = value
    else:
        place[last] = value
