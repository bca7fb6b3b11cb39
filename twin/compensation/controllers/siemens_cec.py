"""SINUMERIK sag and angularity error compensation (CEC, `$AN_CEC`), in which one table can be multiplied by another.

The source is the Function Manual Extended Functions K3, 6FC5397-1BP40-3BA1, 4.4.3. The controller adds the values of
all tables that have the same output axis. A table can name a second table in `$AN_CEC_MULT_BY_TABLE`, by the index of
the second table plus 1. The values of the two tables are then multiplied. The compensation value is the measured
position minus the desired position (section 4.4.1), and the axis moves against it. A table that is used only as a
factor is not enabled itself (SD41300).
"""

from __future__ import annotations

from dataclasses import replace

from twin.arrays import Array
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import (
    AXIS_NAMES,
    REFERENCE_MM,
    ExportOptions,
    FormatOption,
    Names,
    Switch,
    WholeNumber,
)
from twin.compensation.controllers.grids import even_steps, reference_point, require_points
from twin.compensation.controllers.reduction import (
    Profile,
    Term,
    describe_term,
    round_profile,
    select_terms,
    sum_of_terms,
)
from twin.compensation.controllers.siemens_lec import DECIMALS, USUAL_NAMES, number
from twin.errors import DataError

MOST_POINTS = 2000
_FACTOR_DECIMALS = 9

LOSSES = ("terms that depend on all three axes, are worth less than 0.02 µm or do not fit into the tables",)

FIRST_TABLE = FormatOption("first_table", WholeNumber(0), 0, "Siemens CEC: index of the first table.")
MOST_TABLES = FormatOption("tables", WholeNumber(1), 62, "Siemens CEC: maximum number of tables [default: 62].")
NO_PRODUCTS = FormatOption("no_products", Switch(), False, "Siemens CEC: no multiplied tables.")


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of one INI file with all CEC tables and of a part program.
    The part program enables all tables except those that are used only as factors.
    """
    table, names = source.table, choices[AXIS_NAMES] or USUAL_NAMES
    require_points(table, (MOST_POINTS, MOST_POINTS, MOST_POINTS), "MD18342")
    if choices[MOST_TABLES] < 1:
        raise DataError("no table is allowed", hint="State with --tables how many the controller has")
    steps = even_steps(table)
    reference = reference_point(table, choices[REFERENCE_MM])
    chosen = select_terms(table, choices[MOST_TABLES], reference, products=not choices[NO_PRODUCTS])
    kept = tuple(_as_written(one) for one in chosen)
    if not kept:
        raise DataError(
            "the corrections are smaller than this format represents", hint="There is nothing to compensate"
        )

    def correction(axis_positions: Array) -> Array:
        return sum_of_terms(kept, axis_positions)

    used = sum(term.tables for term in kept)
    facts = {"tables": used, "MD18342_at_least": max(table.corrections.shape[:3]), "written": _written(kept)}
    files = {"NC_CEC.INI": _ini(kept, names, steps, choices), "CEC_ENABLE.SPF": _enabling(kept, choices[FIRST_TABLE])}
    return ControllerExport(files, correction, LOSSES, facts)


def _as_written(term: Term) -> Term:
    factor = None if term.factor is None else round_profile(term.factor, _FACTOR_DECIMALS)
    return replace(term, profile=round_profile(term.profile, DECIMALS), factor=factor)


def _written(kept: tuple[Term, ...]) -> str:
    """Describe the written terms, in the order in which they were selected."""
    return ", ".join(
        describe_term(term.profile.axis, None if term.factor is None else term.factor.axis, term.output)
        for term in kept
    )


def _ini(kept: tuple[Term, ...], names: Names, steps: tuple[float, float, float], choices: ExportOptions) -> str:
    lines = ["%_N_NC_CEC_INI", "CHANDATA(1)", "; load with MD32710 $MA_CEC_ENABLE=0 for every output axis"]
    index = choices[FIRST_TABLE]
    for term in kept:
        multiplier = index + 2 if term.factor is not None else 0
        signed = replace(term.profile, values=-choices.sign * term.profile.values + 0.0)
        lines += _table(index, signed, names[term.output], names, steps, multiplier, DECIMALS)
        index += 1
        if term.factor is not None:
            lines += _table(index, term.factor, names[term.output], names, steps, 0, _FACTOR_DECIMALS)
            index += 1
    return "\n".join([*lines, "M17"]) + "\n"


def _table(
    index: int,
    profile: Profile,
    output: str,
    names: Names,
    steps: tuple[float, float, float],
    multiplier: int,
    decimals: int,
) -> list[str]:
    values = [f"$AN_CEC[{index},{node}]={value:.{decimals}f}" for node, value in enumerate(profile.values.tolist())]
    return [
        *values,
        f"$AN_CEC_INPUT_AXIS[{index}]=({names[profile.axis]})",
        f"$AN_CEC_OUTPUT_AXIS[{index}]=({output})",
        f"$AN_CEC_STEP[{index}]={number(steps[profile.axis])}",
        f"$AN_CEC_MIN[{index}]={number(float(profile.nodes[0]))}",
        f"$AN_CEC_MAX[{index}]={number(float(profile.nodes[-1]))}",
        f"$AN_CEC_DIRECTION[{index}]=0",
        f"$AN_CEC_MULT_BY_TABLE[{index}]={multiplier}",
        f"$AN_CEC_IS_MODULO[{index}]=0",
    ]


def _enabling(kept: tuple[Term, ...], first: int) -> str:
    lines, index = ["%_N_CEC_ENABLE_SPF"], first
    for term in kept:
        lines.append(f"$SN_CEC_TABLE_ENABLE[{index}]=1")
        index += 1
        if term.factor is not None:
            lines.append(f"$SN_CEC_TABLE_ENABLE[{index}]=0 ; a factor only")
            index += 1
    return "\n".join([*lines, "M17"]) + "\n"


FORMAT = ExportFormat("siemens-cec", export, (REFERENCE_MM, AXIS_NAMES, FIRST_TABLE, MOST_TABLES, NO_PRODUCTS))
