"""Text of the artefact file of a ball bar."""

from __future__ import annotations

import math

from agent.planning.setup_files.toml_text import TomlText
from agent.planning.setup_proposal.artefact_setup import BarSetup
from twin.artefact.artefact import bar_balls

PROPOSED = "proposed"
NOMINAL = "nominal: type in the certificate before a run on the real machine"


def artefact_text(bar: BarSetup, *, holders_up: bool) -> str:
    """Return the artefact file of a nominal bar, which explains where the certificate is typed in.

    If `holders_up` is True, the holders point along +Z of the artefact frame, towards a vertical spindle, else along
    -Y.
    """
    text = TomlText()
    origin = bar.origins.get
    text.comment(
        "Ball bar with equally spaced balls on holders. Artefact frame: X along the bar, origin at its middle. All "
        "keys: docs/reference/files.md."
    )
    text.comment(
        "BEFORE A RUN ON THE REAL MACHINE: these are nominal centres. Replace them by the centres of the certificate, "
        "balls = [[x, y, z], ...] in mm, one line per ball, set `certificate` to its number and date, and "
        "`standard_uncertainty_um` to its uncertainty (U at k = 2 divided by 2). Without a certificate: measure the "
        "distance of the end balls, and set end_length_mm, end_length_standard_uncertainty_um, and "
        "standard_uncertainty_um = 50. Plans and simulated runs need no certificate."
    )
    text.key("name", f"ball-bar-{bar.length_mm:g}", "appears in reports")
    text.key("certificate", NOMINAL)
    text.key("cte_per_k", 11.5e-6, "thermal expansion of the bar: steel 11.5e-6, carbon fibre about 0.5e-6")
    text.key("cte_standard_uncertainty_per_k", 0.3e-6)
    text.key("ball_diameter_mm", bar.diameter_mm, origin("diameter_mm", "proposed"))
    text.key(
        "standard_uncertainty_um", bar.standard_uncertainty_um, "of each coordinate, k = 1; typical of a certificate"
    )
    if holders_up:
        _add_centres(text, bar)
        return str(text)
    text.section("bar", "Nominal geometry, used until `balls` is given.")
    text.key("balls", bar.balls, _with("number of balls", origin("balls")))
    text.key("length_mm", bar.length_mm, _with("between the centres of the end balls", origin("length_mm")))
    text.key(
        "tilt_deg",
        bar.tilt_deg,
        _with("holders tilted alternately up, out, down and in; 0: straight", origin("tilt_deg")),
    )
    text.key("holder_length_mm", bar.holder_mm, _with("from the axis of the bar to a ball centre", origin("holder_mm")))
    return str(text)


def _add_centres(text: TomlText, bar: BarSetup) -> None:
    """Add the nominal centres of a bar whose holders point along +Z of the artefact frame: those of `bar_balls`,
    rotated about X."""
    origin = bar.origins.get
    text.comment(
        f"Nominal centres in mm: {bar.balls} balls ({origin('balls', PROPOSED)}), {bar.length_mm:g} mm between the end "
        f"balls ({origin('length_mm', PROPOSED)}), on holders of {bar.holder_mm:g} mm "
        f"({origin('holder_mm', PROPOSED)}) along +Z, tilted by {bar.tilt_deg:g}° ({origin('tilt_deg', PROPOSED)}) "
        "alternately to either side, up and down."
    )
    centres = bar_balls(bar.balls, bar.length_mm, math.radians(bar.tilt_deg), bar.holder_mm)
    text.rows("balls", [[round(x, 4), round(z, 4), round(-y, 4)] for x, y, z in centres.tolist()])


def _with(meaning: str, origin: str | None) -> str:
    return f"{meaning}; {origin}" if origin else meaning
