"""Set-up of one new machine on the page: what was stated, what was read and checked, and the files to be written."""

from __future__ import annotations

import math
import secrets
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, RLock
from typing import Any

from agent.files import translated, write_all_atomically
from agent.planning.new_machine.answers import SetupAnswers
from agent.planning.new_machine.controller_setup import MODBUS, SERIAL, SIMULATED, ControllerSetup
from agent.planning.new_machine.field import ProposalsOnly
from agent.planning.new_machine.fields import ADDRESS, CONTROLLER_KIND, FIELDS, MACHINE_CLASS, TRAVEL
from agent.planning.new_machine.new_setup import NewSetup
from agent.planning.new_machine.spindle import spindle_name
from agent.runs.new_machine_files import PREVIEW, NewFiles, prepare_files, refuse_existing
from agent.service.setup.axis_check import Direction, Finding, JogObservation, Part, ProbeFinding
from agent.service.setup.box_problems import BoxProblem, box_problems
from agent.service.setup.controller_watch import ControllerWatch
from drivers.errors import InputError, VolcalError
from drivers.roles import AxisLimits
from twin.machine.kinematic_chain import parse_chain
from twin.units import S_PER_MIN

Document = dict[str, Any]
BY_FLAG = {field.flag: field.name for field in FIELDS.values()}
MISSING = "is needed"


class SetupSession:
    """State of the set-up of one machine in `directory`. It is safe to use from any thread.

    `texts` are the stated values by name of the field, as they were typed. `force` is True if files of the same names
    may be replaced. Nothing is written into `directory` before `write`.
    """

    def __init__(self, directory: Path, texts: Mapping[str, str], *, force: bool) -> None:
        self.directory = directory
        self.token = secrets.token_urlsafe(24)
        self.finished = Event()
        self.watch = ControllerWatch(directory)
        self.files: NewFiles | None = None
        self.written_files: NewFiles | None = None
        self.written: Document | None = None
        self._force = force
        self._texts = dict(texts)
        self._seen: dict[str, JogObservation] = {}
        self._touched_by_hand = False
        self._review: Document | None = None
        self._lock = RLock()
        self._scratch = TemporaryDirectory(prefix="volcal-setup-")

    def close(self) -> None:
        self.watch.close()
        self._scratch.cleanup()

    # ------------------------------------------------------------------ what was stated

    def state(self, texts: Mapping[str, str]) -> Document:
        """Store the texts of fields and return the document. An empty text withdraws the value of its field.

        Raises InputError if there is no such field.
        """
        for name in texts:
            if name not in FIELDS:
                raise InputError(f"there is no field {name!r}", hint=f"one of {', '.join(FIELDS)}", key=name)
        with self._lock:
            former = dict(self._texts)
            self._texts = {name: text for name, text in {**former, **texts}.items() if text.strip()}
            if self._texts != former:
                self.files = self._review = None
            if any(self._texts.get(name) != former.get(name) for name in (CONTROLLER_KIND.name, ADDRESS.name)):
                self.watch.close()
                self._seen.clear()
            return self.document()

    def document(self) -> Document:
        """Return the whole state as the page shows it."""
        with self._lock:
            setup, problems, missing = self._understood()
            return {
                "directory": str(self.directory.absolute()),
                "answers": self._texts,
                "problems": problems,
                "missing": missing,
                "needed": self._needed(),
                "proposals": {} if setup is None else _proposals(setup),
                "reading": _reading(self.watch.limits),
                "connected": self.watch.connected,
                "simulated": self._texts.get(CONTROLLER_KIND.name, SIMULATED) == SIMULATED,
                "axes": self._axis_findings(setup),
                "probe": {"finding": self.watch.probe_finding.value, "by_hand": self._touched_by_hand},
                "review": self._review,
                "written": self.written,
            }

    def _understood(self) -> tuple[NewSetup | None, dict[str, Document], str | None]:
        """Return the set-up that the texts describe, the problem of each field whose text is wrong, and the first field
        that is missing. A problem of no field has the name ""."""
        problems: dict[str, Document] = {}
        for name, text in self._texts.items():
            try:
                FIELDS[name].refuse_malformed(text)
                with translated(InputError):
                    if box_problems(FIELDS[name], text):
                        FIELDS[name].meaning(text)
            except InputError as error:
                problems[name] = _problem(error, name, text)
        good = {name: text for name, text in self._texts.items() if name not in problems}
        try:
            return self._answers(good).collect(), problems, None
        except VolcalError as error:
            name = _field_of(error)
            if name not in good and MISSING in error.message:
                return None, problems, None if name in problems else name
            return None, {name: _problem(error, name, good.get(name, "")), **problems}, None

    def _needed(self) -> list[str]:
        """Return the names of the fields without which nothing can be proposed. All others are optional."""
        has_address = self._texts.get(CONTROLLER_KIND.name) in (MODBUS, SERIAL)
        return [
            MACHINE_CLASS.name,
            *((ADDRESS.name,) if has_address else ()),
            *((TRAVEL.name,) if self.watch.limits is None else ()),
        ]

    def _answers(self, texts: Mapping[str, str]) -> SetupAnswers:
        return SetupAnswers(texts, ProposalsOnly(), self.directory, read_limits=self.watch.limits_of)

    # ------------------------------------------------------------------ controller

    def connect(self) -> Document:
        """Connect to the stated controller and read what it reports. Nothing is moved or written.

        Raises DeviceError if it cannot be reached, and InputError if none that could be reached is stated.
        """
        with self._lock:
            kind = self._texts.get(CONTROLLER_KIND.name, SIMULATED)
            CONTROLLER_KIND.refuse_malformed(kind)
            with translated(InputError, option=ADDRESS.flag):
                controller = ControllerSetup.of(kind, self._texts.get(ADDRESS.name))
            if controller.is_simulated:
                raise InputError("the simulated controller runs only during a run", hint="state its travel")
            self.watch.connect(controller)
            self.files = self._review = None
            return self.document()

    def begin_jog(self, axis: str) -> Document:
        """Begin to watch the axis positions while a person jogs `axis`."""
        self.watch.begin_jog(axis)
        return self.look()

    def look(self) -> Document:
        """Return the axis positions and the jog that is being watched."""
        jog = self.watch.jog()
        position = self.watch.position_mm()
        return {
            "position_mm": [round(value, 4) for value in position],
            "asked": None if jog is None else jog.asked,
            "moved": [] if jog is None else list(jog.moved),
            "distance_mm": None if jog is None else round(jog.distance_mm, 4),
        }

    def judge_jog(self, direction: Direction, part: Part) -> Document:
        """Keep what a person saw during the jog, and return the document. Raises InputError if nothing moved."""
        jog = self.watch.jog()
        if jog is None or not jog.moved:
            raise InputError("no axis has moved", hint="jog the axis by at least 1 mm at the controller's panel")
        with self._lock:
            self._seen[jog.asked] = JogObservation(jog, direction, part)
            return self.document()

    def begin_touch(self) -> ProbeFinding:
        """Begin to watch the probe input anew."""
        self.watch.begin_touch()
        return self.watch.look_at_probe()

    def state_touch(self, *, by_hand: bool) -> Document:
        """Keep whether a person has checked the probe input at the controller's own display."""
        with self._lock:
            self._touched_by_hand = by_hand
            return self.document()

    def _axis_findings(self, setup: NewSetup | None) -> Document:
        if setup is None:
            return {}
        chain = parse_chain(setup.machine.chain)
        return {
            axis: {
                "finding": seen.finding(chain).value,
                "moved": list(seen.jog.moved),
                "distance_mm": round(seen.jog.distance_mm, 4),
                "part": seen.part.value,
            }
            for axis, seen in self._seen.items()
        }

    # ------------------------------------------------------------------ files

    def review(self) -> Document:
        """Prepare and check all files in a scratch directory, and return the document with their review.

        Raises InputError, which names the field, if an answer is missing or impossible, and ConfigurationError if the
        files contradict each other.
        """
        with self._lock:
            if self._review is None:
                for name, text in self._texts.items():
                    FIELDS[name].refuse_malformed(text)
                scratch = Path(self._scratch.name) / secrets.token_hex(4)
                scratch.mkdir()
                self.files = prepare_files(self._answers(self._texts), scratch)
                pictures = self.files.draw(scratch / PREVIEW)
                self._review = _review(self.files, self.directory, pictures)
            return self.document()

    def preview(self, name: str) -> Path | None:
        """Return the path of a file of the preview, None if there is none of this name."""
        with self._lock:
            if self._review is None or name not in self._review["preview"]:
                return None
            return Path(self._review["preview_directory"]) / name

    def write(self) -> Document:
        """Write the reviewed files into the directory, all or none, and return the document.

        Raises InputError if the directory already contains the files of a machine, if the files are not those that were
        reviewed, or if an axis or the probe was found wrong.
        """
        with self._lock:
            self._refuse_wrong_machine()
            files, review = self.files, self._review
            if files is None or review is None:
                raise InputError("the files have not been reviewed", hint="review them, then write them")
            if not self._force and self.written is None:
                refuse_existing(self.directory)
            pictures = {name: (Path(review["preview_directory"]) / name).read_bytes() for name in review["preview"]}
            files.write(self.directory)
            write_all_atomically(self.directory / PREVIEW, pictures)
            self.written_files = files
            self.written = {
                **files.document(self.directory),
                "preview": [str(self.directory / PREVIEW / name) for name in pictures],
            }
            return self.document()

    def _refuse_wrong_machine(self) -> None:
        setup, _, _ = self._understood()
        for axis, checked in self._axis_findings(setup).items():
            if checked["finding"] != Finding.GOOD.value:
                raise InputError(
                    f"the check of axis {axis} found: {checked['finding']}",
                    hint="correct it at the controller or in the chain, and jog the axis again",
                    axis=axis,
                )
        if self.watch.probe_finding is ProbeFinding.ALWAYS_ON:
            raise InputError("the probe input is always on", hint="check probe and wiring, and touch again")


def _field_of(error: VolcalError) -> str:
    """Return the name of the field that an error names by its option or by a key, "" if it names none."""
    option, key = error.where.get("option", ""), error.where.get("key", "")
    return BY_FLAG.get(option) or (key if key in FIELDS else "")


def _problem(error: VolcalError, name: str, text: str) -> Document:
    """Return the problem of a field with this text; its boxes are those that alone are wrong."""
    boxes = box_problems(FIELDS[name], text) if name in FIELDS else []
    if not boxes and "axis" in error.where:
        boxes = [BoxProblem(error.where["axis"], f"field_{name}")]
    return {"detail": error.message, "hint": error.hint, "boxes": [box.as_json() for box in boxes]}


def _reading(limits: AxisLimits | None) -> Document | None:
    """Return what a controller reports; null where it does not report a value."""
    if limits is None:
        return None
    return {
        "lower_mm": _finite(limits.lower_mm),
        "upper_mm": _finite(limits.upper_mm),
        "rapid_mm_per_min": _finite(S_PER_MIN * value for value in limits.rapid_mm_per_s),
        "acceleration_mm_per_s2": _finite(limits.acceleration_mm_per_s2),
    }


def _proposals(setup: NewSetup) -> dict[str, str]:
    """Return the values of a set-up as texts by name of the field, as a person would state them."""
    texts = {name: field.shown(setup) for name, field in FIELDS.items() if field.shown is not None}
    return {name: text for name, text in texts.items() if text is not None}


def _review(files: NewFiles, directory: Path, pictures: Sequence[Path]) -> Document:
    """Return the files with their texts, the plan with its pictures, and the forecast of the gates."""
    setup, job = files.setup, files.chosen.job
    procedure = job.settings.procedure
    return {
        **files.document(directory),
        "texts": dict(files.texts),
        "refused": None if files.refused is None else str(files.refused),
        "preview": [path.name for path in pictures],
        "preview_directory": str(pictures[0].parent),
        "summary": {
            "machine": setup.machine.name,
            "class": setup.machine.kind.name,
            "travel_mm": list(setup.machine.travel_mm),
            "chain": setup.machine.chain,
            "spindle": spindle_name(setup.machine.spindle),
            "artefact": job.artefact.name,
            "balls_of_artefact": job.artefact.count,
            "stations": len(setup.stations.places_mm),
            "position_set": procedure.position_set,
            "touches_per_ball": procedure.touches_per_ball,
        },
    }


def _finite(values: Iterable[float]) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
