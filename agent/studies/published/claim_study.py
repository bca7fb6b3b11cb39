"""Study of the claims of the publication on several machines, in two readings of its method and in all measures of the
volumetric error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import INK, MARKERS, QUIET, SERIES
from agent.studies.measure import MEASURES
from agent.studies.published.claims import (
    BAND_PERCENT,
    DIFFERENCE,
    HARDLY,
    MUCH,
    SUFFICIENT_SHARE,
    TEXTS,
    ClaimFinding,
    examine,
    verdict,
    verdicts_by_place,
)
from agent.studies.published.procedures import evaluate
from agent.studies.study import NAME_COLUMNS, StudyCase, StudyResult

NAME = "claims"
_LIMITS = {"balls": (SUFFICIENT_SHARE,), "trajectory": (0.0,), "tilt S2": (MUCH,), "tilt S2+S3": (-HARDLY, HARDLY)}
_LABELS = {
    "balls": "share of the largest gain with 7 balls",
    "trajectory": "smaller reduction of the VCE, 3→5, 5→11 balls",
    "tilt S2": "reduction of the VCE by 30°",
    "tilt S2+S3": "reduction of the VCE by 30°",
    "sets": "share of the largest gain with S3",
}
_LOWEST = -0.8  # of the ordinate: a share far below says only that the procedure makes the machine much worse
_SPREAD = 0.22  # distance of the measures around the place of a machine and reading


def run(case: StudyCase) -> StudyResult:
    """Check each claim of the publication on the machine of the case and on two other shipped machines."""
    outcomes = evaluate(case)
    artefacts = {one.machine: one.artefact for one in outcomes}
    found = examine(outcomes)
    return StudyResult(
        name=NAME,
        title="Claims of the publication",
        columns=(
            "claim",
            "section",
            "reading",
            "measure",
            "value",
            "machines_p05",
            "machines_p95",
            "share_of_machines",
            "answer",
            "holds",
            *NAME_COLUMNS,
        ),
        rows=[
            (
                name,
                TEXTS[name][0],
                one.reading,
                one.measure,
                one.value,
                *(one.band or (None, None)),
                one.share,
                one.answer,
                one.holds,
                one.machine,
                artefacts[one.machine],
            )
            for name, findings in found.items()
            for one in findings
        ],
        summary=_summary(found),
        subjects=tuple(artefacts.items()),
        draw=partial(_draw, found=found, machines=case.machines),
        size_in=(13.0, 9.6),
    )


def _summary(found: Mapping[str, Sequence[ClaimFinding]]) -> dict[str, object]:
    return {
        "set": "those of each claim",
        "claims": {
            name: {
                "section": TEXTS[name][0],
                "claim": TEXTS[name][1],
                "criterion": TEXTS[name][2],
                "verdict": verdict(findings),
                "by_machine_and_reading": {
                    f"{machine}, {reading}": said for (machine, reading), said in verdicts_by_place(findings).items()
                },
            }
            for name, findings in found.items()
        },
    }


def _draw(figure: Figure, found: Mapping[str, Sequence[ClaimFinding]], machines: int) -> None:
    panels = figure.subplots(2, 3).reshape(-1)
    for panel, (name, findings) in zip(panels, found.items(), strict=True):
        section, text, _ = TEXTS[name]
        panel.set_title(f"{fill(f'{section}: {text}', 52)}\n{verdict(findings)}", fontsize=8.5)
        if name == DIFFERENCE:
            _draw_answers(panel, findings)
        else:
            _draw_findings(panel, name, findings)
    handles, labels = panels[0].get_legend_handles_labels()
    title = (
        f"{BAND_PERCENT[0]:g} to {BAND_PERCENT[1]:g} % of {machines} machines; "
        f"filled: the claim holds, open: it does not; bands end at {_LOWEST:g}"
    )
    figure.legend(handles, labels, loc="outside lower center", ncols=3, title=title)


def _draw_findings(panel: Axes, name: str, findings: Sequence[ClaimFinding]) -> None:
    places = list(dict.fromkeys((one.machine, one.reading) for one in findings))
    for series, measure in enumerate(MEASURES):
        colour, marker = SERIES[series], MARKERS[series]
        panel.plot([], [], color=colour, marker=marker, linestyle="none", label=measure.title)
        for one in (one for one in findings if one.measure == measure.key):
            if one.value is None:
                continue
            at = places.index((one.machine, one.reading)) + _SPREAD * (series - 1)
            if one.band is not None:
                panel.vlines(at, *one.band, color=colour, linewidth=1.4)
            panel.plot(at, one.value, marker, color=colour, mfc=colour if one.holds else "white", markersize=6.5)
            if one.answer and not one.holds:
                panel.annotate(
                    one.answer, (at, one.value), (3, -34), textcoords="offset points", fontsize=6, rotation=90
                )
    for limit in _LIMITS.get(name, ()):
        panel.axhline(limit, color=INK, linestyle="--", linewidth=0.9)
    panel.set_ylim(bottom=max(panel.get_ylim()[0], _LOWEST))
    panel.set_xticks(range(len(places)), [f"{machine}\n{reading}" for machine, reading in places], fontsize=7)
    panel.set_ylabel(_LABELS[name])


def _draw_answers(panel: Axes, findings: Sequence[ClaimFinding]) -> None:
    """Write the best number of balls and the best set of each machine."""
    panel.set_axis_off()
    lines = [f"{one.machine}, {one.reading}, {one.measure.replace('_', ' ')}: {one.answer}" for one in findings]
    panel.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=7.5, color=QUIET, transform=panel.transAxes)
