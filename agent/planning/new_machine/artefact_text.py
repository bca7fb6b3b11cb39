"""Text of the artefact file of a nominal artefact."""

from __future__ import annotations

from typing import Any

from agent.planning.new_machine.artefact_geometry import (
    ArtefactGeometry,
    SolidPart,
    artefact_geometry,
    nominal_length_mm,
    reference_pair,
    turned,
)
from agent.planning.new_machine.artefact_setup import CERTIFICATE, LENGTH, ArtefactSetup
from agent.planning.new_machine.field import SetupField
from agent.planning.new_machine.fields import BALL_DIAMETER, BALLS, HOLDER, SIZE, TILT
from agent.planning.new_machine.machine_setup import PROPOSED
from agent.planning.new_machine.spindle import BESIDE, holder_direction
from agent.planning.new_machine.toml_text import TomlText
from twin.artefact.artefact import Artefact
from twin.collision.probe_frame import ProbeFrame
from twin.formats.artefact_file import parse_artefact

NOMINAL = "nominal: type in the certificate before a run on the real machine"
UNCERTIFIED = "none: nominal centres"

FRAMES = {
    "tilted-bar": "Ball bar with holders tilted alternately to all sides. Artefact frame: X along the bar, origin at "
    "its middle.",
    "straight-bar": "Straight ball bar. Artefact frame: X along the bar, origin at its middle.",
    "ball-plate": "Square ball plate. Artefact frame: origin in the middle of the rear face, where the shaft of the "
    "mount is fixed.",
    "tetrahedron": "Regular tetrahedron of rods with balls on its corners and edges. Artefact frame: origin in the "
    "middle of the face that is fixed to the shaft of the mount by three further rods.",
}
SIZES = {
    "ball-plate": "between the corner balls along a side",
    "tetrahedron": "edge",
}
WITH_CERTIFICATE = (
    "BEFORE A RUN ON THE REAL MACHINE: these are nominal centres. Replace them by the centres of the certificate, "
    "balls = [[x, y, z], ...] in mm, one line per ball, set `certificate` to its number and date, and "
    "`standard_uncertainty_um` to its uncertainty (U at k = 2 divided by 2). Plans and simulated runs need no "
    "certificate."
)
WITH_LENGTH = (
    "BEFORE A RUN ON THE REAL MACHINE: the distance of two balls is the only certified value. Check it below. The "
    "other centres are nominal; they must be right to 50 µm (k = 1), so measure them if they are not. The run finds "
    "them: docs/how-to/calibrate-without-a-certificate.md."
)
WITH_NOTHING = (
    "Nothing of this artefact is certified: the shape of the machine's errors can be found with it, but no scale. All "
    "lengths may be wrong in proportion. State the certified distance of two balls to find the scale too: "
    "docs/how-to/calibrate-without-a-certificate.md."
)


def artefact_text(artefact: ArtefactSetup, spindle: ProbeFrame) -> str:
    """Return the text of an artefact file with nominal ball centres. Comments in the text explain where the values of
    the certificate have to be entered.

    The holders point against the stylus: along Z of the artefact frame if the stylus is vertical, else along -Y.
    """
    text, kind = TomlText(), artefact.calibration.kind
    text.comment(f"{FRAMES[artefact.shape]} All keys: docs/reference/files.md.")
    text.comment({CERTIFICATE: WITH_CERTIFICATE, LENGTH: WITH_LENGTH}.get(kind, WITH_NOTHING))
    text.key("name", f"{_name(artefact)}-{artefact.size_mm:g}", "appears in reports")
    text.key("certificate", NOMINAL if kind == CERTIFICATE else UNCERTIFIED)
    text.key("cte_per_k", 11.5e-6, "thermal expansion: steel 11.5e-6, carbon fibre about 0.5e-6")
    text.key("cte_standard_uncertainty_per_k", 0.3e-6)
    BALL_DIAMETER.write(text, artefact.diameter_mm, {BALL_DIAMETER.name: PROPOSED, **artefact.origins})
    text.key(
        "standard_uncertainty_um",
        artefact.calibration.standard_uncertainty_um,
        "of each coordinate, k = 1" + ("; typical of a certificate" if kind == CERTIFICATE else "; not certified"),
    )
    if artefact.is_bar and kind == LENGTH:
        text.key("end_length_mm", _length(artefact), "between the centres of the two balls that are farthest apart")
        text.key("end_length_standard_uncertainty_um", artefact.calibration.length_uncertainty_um, "k = 1")
    if artefact.is_bar and not spindle.is_vertical:
        _add_bar(text, artefact)
        return str(text)
    geometry = artefact_geometry(artefact).turned(spindle)
    _add_centres(text, artefact, geometry, spindle)
    if not artefact.is_bar:
        _add_frame(text, artefact, geometry, spindle)
    return str(text)


def nominal(artefact: ArtefactSetup, spindle: ProbeFrame) -> Artefact:
    """Return the artefact that the artefact file of `artefact_text` describes."""
    return parse_artefact(artefact_text(artefact, spindle), "nominal artefact")


def _name(artefact: ArtefactSetup) -> str:
    return "ball-bar" if artefact.is_bar else artefact.shape


def _length(artefact: ArtefactSetup) -> float:
    stated = artefact.calibration.length_mm
    return round(nominal_length_mm(artefact), 4) if stated is None else stated


def _add_bar(text: TomlText, artefact: ArtefactSetup) -> None:
    """Add the section of a bar whose holders point along -Y."""
    text.section("bar", "Nominal geometry, used until `balls` is given.")
    BALLS.write(text, artefact.balls, artefact.origins)
    SIZE.write(text, artefact.size_mm, artefact.origins)
    TILT.write(text, artefact.tilt_deg, artefact.origins)
    HOLDER.write(text, artefact.holder_mm, artefact.origins)


def _add_centres(text: TomlText, artefact: ArtefactSetup, geometry: ArtefactGeometry, spindle: ProbeFrame) -> None:
    """Add the nominal centres of the balls."""

    def origin(field: SetupField[Any]) -> str:
        return artefact.origins.get(field.name, PROPOSED)

    axis = "-Y" if holder_direction(spindle) == BESIDE else "+Z" if spindle.sign < 0 else "-Z"
    tilt = (
        f", tilted by {artefact.tilt_deg:g}° ({origin(TILT)}) alternately to either side, up and down"
        if artefact.tilt_deg
        else ""
    )
    text.comment(
        f"Nominal centres in mm: {artefact.balls} balls ({origin(BALLS)}), {artefact.size_mm:g} mm "
        f"{SIZES.get(artefact.shape, 'between the end balls')} ({origin(SIZE)}), on holders of "
        f"{artefact.holder_mm:g} mm ({origin(HOLDER)}) along {axis}{tilt}."
    )
    text.rows("balls", [[_rounded(value) for value in ball] for ball in geometry.balls])


def _add_frame(text: TomlText, artefact: ArtefactSetup, geometry: ArtefactGeometry, spindle: ProbeFrame) -> None:
    """Add the holders and the parts that carry them, and the certified length if there is one."""
    text.section("holders", "Rods from the part that carries them to the balls.")
    text.key("radius_mm", 4.0)
    text.key("direction", [_rounded(value) for value in turned(BESIDE, spindle)], "from the foot to the ball")
    text.key("length_mm", artefact.holder_mm)
    for part in geometry.parts:
        text.section("[bodies]")
        text.key("name", part.name)
        _add_part(text, part)
    if artefact.calibration.kind == LENGTH:
        text.section("[reference_lengths]", "Certified distance of two balls; balls are counted from 0.")
        text.key("balls", list(reference_pair(artefact)))
        text.key("length_mm", _length(artefact))
        text.key("standard_uncertainty_um", artefact.calibration.length_uncertainty_um, "k = 1")


def _add_part(text: TomlText, part: SolidPart) -> None:
    names = ("from_mm", "to_mm") if part.radius_mm > 0.0 else ("lower_mm", "upper_mm")
    for name, corner in zip(names, (part.start_mm, part.end_mm), strict=True):
        text.key(name, [_rounded(value) for value in corner])
    if part.radius_mm > 0.0:
        text.key("radius_mm", part.radius_mm)


def _rounded(value: float) -> float:
    return round(value, 4) + 0.0
