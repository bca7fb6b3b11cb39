"""Volumetric error of a family of machines (a distribution of machine errors), and a map of the deviation of a typical
machine.

The square of the volumetric error is a quadratic form of the error parameters of a machine. It is therefore not
necessary to evaluate the error on a grid of the workspace for each machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BLUE, GREEN, INK, ORANGE
from agent.studies.measure import MEASURES
from agent.studies.plane_map import PLANE_SHAPE, Plane, draw_plane, map_nodes
from agent.studies.procedure_value import ProcedureEvaluator
from agent.studies.study import StudyCase, StudyResult
from agent.studies.workers import generator
from twin.arrays import Array
from twin.machine.machine_population import Family
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.work_frame import WorkFrameForm

NAME = "volumetric-error"
PUBLISHED_MEDIAN_UM = 11.9
PERCENTS = (0.0, 1.0, 2.5, *np.arange(5.0, 100.0, 5.0).tolist(), 97.5, 99.0, 100.0)


@dataclass(frozen=True, eq=False)
class FamilyErrors:
    """Parameters and volumetric errors of m machines drawn from a family. `parameters` (m, p) contains the p error
    parameters of each machine. `raw_um` contains the volumetric error of each machine in µm as defined, and
    `work_frame_um` and `aligned_um` contain it in the other measures of `agent.studies.measure`.
    """

    parameters: Array
    raw_um: Array
    work_frame_um: Array
    aligned_um: Array

    @property
    def typical(self) -> int:
        """Index of the machine whose volumetric error `raw_um` is nearest to the median over all machines."""
        return int(np.abs(self.raw_um - np.median(self.raw_um)).argmin())


def run(case: StudyCase) -> StudyResult:
    """Compute the distribution of the volumetric error over `case.machines` random machines of the family. Also compute
    a map of the deviation for the machine whose error is nearest to the median.
    """
    what, family = "volumetric error", case.assumptions.family
    case.progress(what, 0, 2)
    evaluator = ProcedureEvaluator(case)
    field = evaluator.field
    case.progress(what, 1, 2)
    found = draw_family(family, evaluator.work_frame, case.machines, generator(case.seed, 0))
    planes = median_planes(field, found.parameters[found.typical])
    case.progress(what, 2, 2)
    errors = [np.percentile(values, PERCENTS).tolist() for values in _all(found)]
    return StudyResult(
        name=NAME,
        title="Volumetric error of the family",
        columns=("percent_of_machines", *(f"ve_{measure.key}_um" for measure in MEASURES)),
        rows=list(zip(PERCENTS, *errors, strict=True)),
        summary=_summary(found),
        draw=partial(_draw, found=found, planes=planes),
        size_in=(10.0, 4.6),
    )


def draw_family(family: Family, form: WorkFrameForm, machines: int, rng: np.random.Generator) -> FamilyErrors:
    """Draw random machines of a family and return their parameters and volumetric errors. `form` gives the squared
    error as a quadratic form of the parameters. It includes the deflection of the machine, which is the same for all
    machines.
    """
    parameters = family.draw(rng, machines)
    raw_mm, aligned_mm = form.field.form.values(parameters)
    return FamilyErrors(parameters, 1e3 * raw_mm, 1e3 * form.values_mm(parameters), 1e3 * aligned_mm)


def _all(found: FamilyErrors) -> tuple[Array, Array, Array]:
    """Return the volumetric errors in the order of `MEASURES`."""
    return found.raw_um, found.work_frame_um, found.aligned_um


def median_planes(field: FieldForm, parameters: Array) -> tuple[Plane, Plane]:
    """Return two maps of the length of the deviation in one horizontal plane, for the machine with the given
    parameters. The first map shows the raw deviation. The second map shows the deviation after the best-fitting rigid
    motion of the workspace is removed.
    """
    x_mm, y_mm, height_mm = map_nodes(field.model.ranges_mm)
    points = np.stack(np.meshgrid(x_mm, y_mm, [height_mm], indexing="ij"), axis=-1).reshape(-1, 3)
    maps = []
    for aligned in (False, True):
        basis, deflection = field.columns_at(points, aligned)
        length_mm = np.linalg.norm(basis @ parameters + deflection, axis=1)
        maps.append(1e3 * length_mm.reshape(PLANE_SHAPE))
    where = f"Z = {height_mm:g} mm"
    return (
        Plane(f"{where}, as defined", x_mm, y_mm, maps[0]),
        Plane(f"{where}, best rigid motion of the workspace removed", x_mm, y_mm, maps[1]),
    )


def _summary(found: FamilyErrors) -> dict[str, object]:
    medians = {
        **{
            f"median_ve_{measure.key}_um": float(np.median(values))
            for measure, values in zip(MEASURES, _all(found), strict=True)
        },
        "published_median_um": PUBLISHED_MEDIAN_UM,
        "map_of_machine": found.typical,
        "map_ve_raw_um": float(found.raw_um[found.typical]),
    }
    middle = {
        f"ve_{measure.key}_p{percent:02d}_um": float(np.percentile(values, percent))
        for measure, values in zip(MEASURES, _all(found), strict=True)
        for percent in (5, 95)
    }
    return {**medians, **middle}


def _draw(figure: Figure, found: FamilyErrors, planes: tuple[Plane, Plane]) -> None:
    layout = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.35))
    _draw_distribution(figure.add_subplot(layout[:, 0]), found)
    top_um = max(float(plane.length_um.max()) for plane in planes)
    maps = [figure.add_subplot(layout[row, 1]) for row in range(2)]
    images = [draw_plane(axes, plane, top_um) for axes, plane in zip(maps, planes, strict=True)]
    bar = figure.colorbar(images[0], ax=maps, shrink=0.9, pad=0.02)
    bar.set_label("deviation of the median machine / µm")


def _draw_distribution(axes: Axes, found: FamilyErrors) -> None:
    below_legend = 0.76
    bins = np.linspace(0.0, float(found.raw_um.max()), 1 + round(2.5 * len(found.raw_um) ** (1 / 3))).tolist()
    for values, colour, measure in zip(_all(found), (BLUE, GREEN, ORANGE), MEASURES, strict=True):
        median = float(np.median(values))
        axes.hist(values, bins, color=colour, alpha=0.45, label=f"{measure.title}, median {median:.1f} µm")
        axes.axvline(median, ymax=below_legend, color=colour, linewidth=1.2)
    published = f"published median {PUBLISHED_MEDIAN_UM} µm"
    axes.axvline(PUBLISHED_MEDIAN_UM, ymax=below_legend, color=INK, linestyle="--", label=published)
    axes.set_title(f"{len(found.raw_um)} machines of the family")
    axes.set_xlabel("VE / µm")
    axes.set_ylabel("machines")
    axes.set_ylim(0.0, axes.get_ylim()[1] / below_legend)
    axes.legend(loc="upper left")
