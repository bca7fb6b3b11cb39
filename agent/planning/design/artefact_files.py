"""Files of the design of an artefact with its mount: artefact, position set and settings of the best one, the table of
all variants, and the figure."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from agent.figures.heading import subject
from agent.figures.style import headed, picture
from agent.files import write_all_atomically
from agent.planning.design.artefact_design import ArtefactDesign, DesignedVariant
from agent.planning.design.artefact_figure import FIGURE_SIZE_IN, draw_artefact_design
from agent.planning.design.artefact_variants import ArtefactVariant
from agent.planning.design.design_result import Prove
from agent.planning.design.pareto_front import format_front
from agent.planning.job import Job
from agent.planning.new_machine.toml_text import TomlText
from agent.settings.schema import Settings
from twin.formats.artefact_file import format_artefact
from twin.formats.position_set_file import format_positions

ARTEFACT, COVARIANCE, POSITIONS, SETTINGS = "artefact.toml", "artefact-covariance.csv", "positions.csv", "settings.toml"
VARIANTS, DESIGNS, FRONT, FIGURE = "variants.csv", "designs.csv", "front.csv", "artefact-design"
COLUMNS = (
    "length_mm",
    "balls",
    "spacing",
    "tilt_deg",
    "rotation_centre",
    "across_mm",
    "height_mm",
    "stations",
    "purchase_euro",
    "expected_vce_aligned_um",
    "machine_minutes",
    "run_euro",
    "positions",
    "ball_centres",
    "best",
    "refused",
)
"""Columns of both tables of variants. In that of the screened ones, the best are those on the Pareto front."""

_NOTE = "Nominal bar of `volcal design artefact`. Replace the centres and their covariance by those of the certificate."


def write_artefact_design(found: ArtefactDesign, slot_minutes: float, budget_euro: float, folder: Path) -> list[Path]:
    """Write all files of the design into `folder`, or none of them. Return their paths."""
    best = found.best.result
    machine, artefact = best.problem.job.machine, best.problem.job.artefact
    heading = subject(machine.name, artefact.name)
    artefact_text, covariance = format_artefact(artefact, COVARIANCE, [_NOTE])
    draw = partial(draw_artefact_design, found=found, slot_minutes=slot_minutes, budget_euro=budget_euro)
    drawn = picture(FIGURE, headed(draw, f"machine {machine.name}"), FIGURE_SIZE_IN)
    contents: dict[str, str | bytes] = {
        ARTEFACT: artefact_text,
        COVARIANCE: covariance,
        POSITIONS: format_positions(best.positions, heading),
        SETTINGS: format_settings(best.problem.job.settings),
        VARIANTS: format_variants(found),
        DESIGNS: format_designs(found),
        FRONT: format_front(best.front, machine.name, artefact.name),
        f"{FIGURE}.png": drawn.png,
        f"{FIGURE}.svg": drawn.svg,
    }
    write_all_atomically(folder, contents)
    return [folder / name for name in contents]


def with_artefact_file(prove: Prove) -> Prove:
    """Return a function that carries out the preflight `prove` of a job whose artefact is in no file yet: the simulated
    machine reads it from one."""

    def proved(job: Job) -> object:
        with TemporaryDirectory() as folder:
            path = Path(folder) / ARTEFACT
            artefact_text, covariance = format_artefact(job.artefact, COVARIANCE)
            write_all_atomically(path.parent, {ARTEFACT: artefact_text, COVARIANCE: covariance})
            return prove(replace(job, settings=job.settings.model_copy(update={"artefact": path})))

    return proved


def format_variants(found: ArtefactDesign) -> str:
    """Return all screened variants as CSV text, one per line. Cells of a variant that cannot be measured are empty, and
    the last one says why."""
    front = set(found.euro_front)
    return _table(
        (
            *_properties(one.variant),
            f"{one.purchase_euro:.2f}",
            *(f"{value:.4f}" if one.measurable else "" for value in (one.vce_um, one.minutes, one.run_euro)),
            *((one.positions, one.balls) if one.measurable else ("", "")),
            "yes" if one in front else "no",
            one.reason,
        )
        for one in found.screened
    )


def format_designs(found: ArtefactDesign) -> str:
    """Return the present equipment and all variants that were designed completely as CSV text with the same
    columns."""
    designs = {one.variant: one for one in (found.present, *found.finalists, found.best)}
    return _table(_designed(one, best=one.variant == found.best.variant) for one in designs.values())


def _designed(one: DesignedVariant, *, best: bool) -> tuple[object, ...]:
    head = (*_properties(one.variant), f"{one.purchase_euro:.2f}")
    if one.design is None:
        return (*head, "", "", "", "", "", "no", one.reason)
    values = (one.vce_um, one.design.minutes, one.run_euro)
    numbers = (*(f"{value:.4f}" for value in values), len(one.design.positions), one.design.balls)
    return (*head, *numbers, "yes" if best else "no", "")


def _properties(v: ArtefactVariant) -> tuple[object, ...]:
    lengths = (f"{v.length_mm:g}", v.balls, v.spacing_text, f"{v.tilt_deg:g}", v.centre)
    return (*lengths, f"{v.across_mm:g}", f"{v.height_mm:g}", v.stations)


def _table(rows: Iterable[tuple[object, ...]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    return text.getvalue()


def format_settings(settings: Settings) -> str:
    """Return the text of a settings file with the values of `settings` that differ from the defaults, and with the
    artefact and the positions of its folder."""
    document = settings.model_dump(mode="json", exclude_defaults=True)
    document["artefact"] = ARTEFACT
    document.setdefault("procedure", {})["position_set"] = POSITIONS
    for key in ("machine", "state_directory"):
        document[key] = str(getattr(settings, key))
    text = TomlText()
    text.comment(
        "Settings of `volcal design artefact` for the artefact, the mount and the positions of this folder. "
        "They hold the values that differ from the defaults."
    )
    _add(text, "", document)
    return str(text)


def _add(text: TomlText, name: str, section: Mapping[str, Any]) -> None:
    """Add a section: its values first, then the sections in it."""
    inner = {key: value for key, value in section.items() if isinstance(value, Mapping)}
    values = {key: value for key, value in section.items() if key not in inner and value is not None}
    if name and values:
        text.section(name)
    for key, value in values.items():
        text.key(key, value)
    for key, value in inner.items():
        _add(text, f"{name}.{key}" if name else key, value)
