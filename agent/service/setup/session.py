"""Set-up of one new machine on the page: what was stated, what was read and checked, and the files to be written."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, RLock
from typing import Any

from agent.files import translated, write_all_atomically
from agent.planning.setup_files.new_setup import NewSetup
from agent.planning.setup_proposal.axis_check import Direction, Finding, JogObservation, Part, ProbeFinding
from agent.planning.setup_proposal.controller_setup import SIMULATED, ControllerSetup
from agent.runs.new_machine.answers import InitOptions, SetupAnswers
from agent.runs.new_machine.fields import SETUP_FIELDS
from agent.runs.new_machine.new_files import PREVIEW, NewFiles, prepare_files, refuse_existing
from agent.runs.new_machine.questions import ProposalsOnly
from agent.service.setup.controller_watch import ControllerWatch
from agent.service.setup.documents import proposal_texts, reading_document, review_document
from drivers.errors import InputError, VolcalError
from twin.machine.kinematic_chain import parse_chain

Document = dict[str, Any]
FIELDS = {field.name: field for field in SETUP_FIELDS}
BY_FLAG = {field.flag: field.name for field in SETUP_FIELDS}
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
            if any(self._texts.get(name) != former.get(name) for name in ("controller", "address")):
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
                "proposals": {} if setup is None else proposal_texts(setup),
                "reading": reading_document(self.watch.limits),
                "connected": self.watch.connected,
                "simulated": self._texts.get("controller", SIMULATED) == SIMULATED,
                "axes": self._axis_findings(setup),
                "probe": {"finding": self.watch.probe_finding.value, "by_hand": self._touched_by_hand},
                "review": self._review,
                "written": self.written,
            }

    def _understood(self) -> tuple[NewSetup | None, dict[str, Document], str | None]:
        """Return the set-up that the texts describe, the problem of each field whose text is wrong, and the first field
        that is missing. A problem of no field has the name ""."""
        options: dict[str, Any] = {}
        problems: dict[str, Document] = {}
        for name, text in self._texts.items():
            try:
                options[name] = FIELDS[name].read(text)
            except InputError as error:
                problems[name] = _problem(error)
        try:
            return self._answers(options).collect(), problems, None
        except VolcalError as error:
            name = _field_of(error)
            if name not in options and MISSING in error.message:
                return None, problems, None if name in problems else name
            return None, {name: _problem(error), **problems}, None

    def _answers(self, options: Mapping[str, Any]) -> SetupAnswers:
        return SetupAnswers(InitOptions(**options), ProposalsOnly(), self.directory, read=self.watch.limits_of)

    # ------------------------------------------------------------------ controller

    def connect(self) -> Document:
        """Connect to the stated controller and read what it reports. Nothing is moved or written.

        Raises DeviceError if it cannot be reached, and InputError if none that could be reached is stated.
        """
        with self._lock:
            texts = {name: self._texts.get(name) for name in ("controller", "address")}
            kind = FIELDS["controller"].read(texts["controller"] or SIMULATED)
            with translated(InputError, option="--address"):
                controller = ControllerSetup.of(kind, texts["address"])
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
                options = {name: FIELDS[name].read(text) for name, text in self._texts.items()}
                scratch = Path(self._scratch.name) / secrets.token_hex(4)
                scratch.mkdir()
                self.files = prepare_files(self._answers(options), scratch)
                pictures = self.files.draw(scratch / PREVIEW)
                self._review = review_document(self.files, self.directory, pictures)
            return self.document()

    def preview(self, name: str) -> Path | None:
        """Return the path of a file of the preview, None if there is none of this name."""
        with self._lock:
            if self._review is None or name not in self._review["preview"]:
                return None
            return Path(self._review["preview_directory"]) / name

    def write(self) -> Document:
        """Write the reviewed files into the directory, all or none, and return the document.

        Raises InputError if there are files of a machine already, if the files are not those that were reviewed, or if
        an axis or the probe was found wrong.
        """
        with self._lock:
            self._refuse_wrong_machine()
            files, review = self.files, self._review
            if files is None or review is None:
                raise InputError("the files have not been reviewed", hint="review them, then write them")
            if not self._force and self.written is None:
                refuse_existing(self.directory)
            pictures = {name: (Path(review["preview_directory"]) / name).read_bytes() for name in review["preview"]}
            paths = files.write(self.directory)
            write_all_atomically(self.directory / PREVIEW, pictures)
            self.written_files = files
            self.written = {
                **files.document(self.directory),
                "preview": [str(self.directory / PREVIEW / name) for name in pictures],
                "files": [str(path) for path in paths],
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


def _problem(error: VolcalError) -> Document:
    return {"detail": error.message, "hint": error.hint}
