"""SINUMERIK sag and angularity error compensation (CEC, `$AN_CEC`), in which one table can be multiplied by another.

The source is the Function Manual Extended Functions K3, 6FC5397-1BP40-3BA1, 4.4.3. The controller adds the values of
all tables that have the same output axis. A table can name a second table in `$AN_CEC_MULT_BY_TABLE`, by the index of
the second table plus 1. The values of the two tables are then multiplied. The compensation value is the measured
position minus the desired position (section 4.4.1), and the axis moves against it.

The manual says that the product is added to the compensation value. It does not say whether the two tables then still
act by themselves, and an example in the manual of the 802D sl works only if they do not. A product is therefore written
as two pairs of tables, a × b and (-a) × (-b). Both pairs give the same product, and the four tables by themselves add
up to zero. The correction is thus the same in both readings, provided that all four tables are enabled (SD41300). The
values of a and b have about the same size, so no table is larger than necessary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.all_options import FIRST_TABLE, MOST_TABLES, NO_PRODUCTS
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import (
    AXIS_NAMES,
    REFERENCE_MM,
    ExportOptions,
    Names,
)
from twin.compensation.controllers.grids import even_steps, reference_point, require_points
from twin.compensation.controllers.reduction import (
    Profile,
    Term,
    describe_term,
    round_profile,
    select_terms,
)
from twin.compensation.controllers.siemens_lec import DECIMALS, USUAL_NAMES, number
from twin.errors import DataError

MOST_POINTS = 2000
_PRODUCT_DECIMALS = 9
_TABLES_PER_PRODUCT = 4

LOSSES = ("terms that depend on all three axes, are worth less than 0.02 µm or do not fit into the tables",)


@dataclass(frozen=True, eq=False)
class _WrittenTerm:
    """Term of the correction as the controller has it. `profiles` contains its function of one axis position in mm, or
    the two functions a and b of a product. The correction is then twice the product of a and b.
    """

    term: Term
    profiles: tuple[Profile, ...]

    def at(self, axis_positions: Array) -> Array:
        first, *second = (profile.at(axis_positions) for profile in self.profiles)
        return 2.0 * first * second[0] if second else first

    @property
    def tables(self) -> int:
        return 1 if len(self.profiles) == 1 else _TABLES_PER_PRODUCT


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of one INI file with all CEC tables and of a part program.
    The part program enables all tables.
    """
    table, names = source.table, choices[AXIS_NAMES] or USUAL_NAMES
    require_points(table, (MOST_POINTS, MOST_POINTS, MOST_POINTS), "MD18342")
    if choices[MOST_TABLES] < 1:
        raise DataError("no table is allowed", hint="State with --tables how many the controller has")
    steps = even_steps(table)
    reference = reference_point(table, choices[REFERENCE_MM])
    tables_per_product = None if choices[NO_PRODUCTS] else _TABLES_PER_PRODUCT
    chosen = select_terms(table, choices[MOST_TABLES], reference, tables_per_product=tables_per_product)
    kept = [_as_written(one) for one in chosen]
    if not kept:
        raise DataError(
            "the corrections are smaller than this format represents", hint="There is nothing to compensate"
        )

    def correction(axis_positions: Array) -> Array:
        total = np.zeros_like(axis_positions)
        for one in kept:
            total[:, one.term.output] += one.at(axis_positions)
        return total

    used = sum(one.tables for one in kept)
    facts = {"tables": used, "MD18342_at_least": max(table.corrections.shape[:3]), "written": _description(chosen)}
    first = choices[FIRST_TABLE]
    files = {"NC_CEC.INI": _ini(kept, names, steps, choices), "CEC_ENABLE.SPF": _enabling(range(first, first + used))}
    return ControllerExport(files, correction, LOSSES, facts)


def _as_written(term: Term) -> _WrittenTerm:
    """Return the term with the rounded values of its tables.

    The two functions of a product get the same largest value.
    """
    if term.factor is None:
        return _WrittenTerm(term, (round_profile(term.profile, DECIMALS),))
    # With p the profile and f the factor, s p and f / s have the same largest value for s = √(max|f| / max|p|).
    scale = float(np.sqrt(np.abs(term.factor.values).max() / np.abs(term.profile.values).max()))
    # Each of the two pairs gives half the product, hence √½ in both functions.
    first, second = (
        round_profile(replace(one, values=np.sqrt(0.5) * by * one.values), _PRODUCT_DECIMALS)
        for one, by in ((term.profile, scale), (term.factor, 1.0 / scale))
    )
    return _WrittenTerm(term, (first, second))


def _description(terms: Sequence[Term]) -> str:
    """Describe the written terms, in the order in which they were selected."""
    return ", ".join(
        describe_term(term.profile.axis, None if term.factor is None else term.factor.axis, term.output)
        for term in terms
    )


def _ini(kept: Sequence[_WrittenTerm], names: Names, steps: tuple[float, float, float], choices: ExportOptions) -> str:
    lines = ["%_N_NC_CEC_INI", "CHANDATA(1)", "; load with MD32710 $MA_CEC_ENABLE=0 for every output axis"]
    index = choices[FIRST_TABLE]
    for one in kept:
        output, (first, *second) = names[one.term.output], one.profiles
        against = _times(first, -choices.sign)
        if second:
            for sign in (1, -1):
                # The multiplier is named by its index plus 1, and it is the next table: index + 2.
                lines += _table(index, _times(against, sign), output, names, steps, index + 2, _PRODUCT_DECIMALS)
                lines += _table(index + 1, _times(second[0], sign), output, names, steps, 0, _PRODUCT_DECIMALS)
                index += 2
        else:
            lines += _table(index, against, output, names, steps, 0, DECIMALS)
            index += 1
    return "\n".join([*lines, "M17"]) + "\n"


def _times(profile: Profile, sign: int) -> Profile:
    return replace(profile, values=sign * profile.values + 0.0)


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


def _enabling(indices: range) -> str:
    lines = [f"$SN_CEC_TABLE_ENABLE[{index}]=1" for index in indices]
    return "\n".join(["%_N_CEC_ENABLE_SPF", *lines, "M17"]) + "\n"


FORMAT = ExportFormat("siemens-cec", export)
