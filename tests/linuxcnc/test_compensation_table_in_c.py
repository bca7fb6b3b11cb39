"""Tests of the components' C code, compiled unchanged: parsing a file and looking up a table."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from compensation_rig import COMPONENTS, trilinear
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from requirements import skip_if_missing

from drivers.roles import TableImage
from drivers.tables.text import format_table

HEADERS = Path("/usr/include/linuxcnc/rtapi.h")
MISSING = "" if HEADERS.exists() and shutil.which("gcc") else "linuxcnc-uspace-dev OR gcc IS NOT INSTALLED"
pytestmark = skip_if_missing(MISSING)

OK, MALFORMED, CRC_DIFFERS, BEYOND_LIMITS = 0, 4, 5, 6
ENTRIES = """
#include "volcal_table_file.h"
static volcal_slot slot;
int read_table(const char *text, size_t length) {
    volcal_crc_prepare();
    return volcal_parse(text, length, 1.0, &slot);
}
void look_up(const double *position, double *correction) { volcal_lookup(&slot, position, correction); }
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    folder = tmp_path_factory.mktemp("c")
    (folder / "entries.c").write_text(ENTRIES)
    strict = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-fsanitize=undefined", "-fno-sanitize-recover"]
    subprocess.run(
        ["gcc", "-O1", "-shared", "-fPIC", "-DULAPI", *strict, f"-I{HEADERS.parent}", f"-I{COMPONENTS}",
         "entries.c", "-o", "entries.so"],
        cwd=folder, check=True, timeout=600.0,
    )  # fmt: skip
    return ctypes.CDLL(str(folder / "entries.so"))


def read(library: ctypes.CDLL, text: str) -> int:
    data = text.encode("latin-1")
    return int(library.read_table(data, ctypes.c_size_t(len(data))))


def look_up_correction(library: ctypes.CDLL, position: np.ndarray) -> list[float]:
    correction = (ctypes.c_double * 3)()
    library.look_up((ctypes.c_double * 3)(*position), correction)
    return list(correction)


@st.composite
def tables(draw: st.DrawFn) -> TableImage:
    """Draw a grid of up to 4 nodes per axis, with corrections up to 1 mm within the slope limit."""
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4)))
    counts = draw(arrays(np.int32, (*shape, 3), elements=st.integers(-10000, 10000)))
    origin = draw(st.tuples(*[st.floats(-1000.0, 1000.0)] * 3))
    step = draw(st.tuples(*[st.floats(20.0, 500.0)] * 3))
    return TableImage(origin, step, 1e-4, counts)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(tables(), st.lists(st.tuples(*[st.floats(-2500.0, 4000.0)] * 3), min_size=1, max_size=5))
def test_lookup_is_trilinear_and_constant_beyond(library: ctypes.CDLL, table: TableImage, places: list) -> None:
    assert read(library, format_table(table)) == OK
    last = np.array(table.shape) - 1
    for place in [*map(np.array, places), np.array(table.origin_mm) + last * table.step_mm]:
        assert look_up_correction(library, place) == pytest.approx(trilinear(table, place[None])[0], abs=1e-12)


@given(tables(), st.data())
def test_cut_or_changed_files_are_refused(library: ctypes.CDLL, table: TableImage, data: st.DataObject) -> None:
    text = format_table(table)
    at = data.draw(st.integers(0, len(text) - 1))
    other = data.draw(st.characters(min_codepoint=0, max_codepoint=255).filter(lambda c: c != text[at]))
    assert read(library, text[:at]) in (MALFORMED, CRC_DIFFERS)
    assert read(library, text[:at] + other + text[at + 1 :]) in (MALFORMED, CRC_DIFFERS)


SMALL = TableImage((0.0, 0.0, 0.0), (10.0, 10.0, 10.0), 1e-4, np.zeros((1, 1, 2, 3), dtype=np.int32))
BODY = format_table(SMALL).partition("file_crc32")[0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("table 1", "table 2"),
        ("nodes 1 1 2", "nodes 1 1 3"),
        ("nodes 1 1 2", "nodes 0 1 2"),
        ("nodes 1 1 2", "nodes 257 1 2"),
        ("nodes 1 1 2", "nodes 256 256 256"),
        ("step_mm 10.0", "step_mm 0.0"),
        ("step_mm 10.0", "step_mm -10.0"),
        ("step_mm 10.0", "step_mm nan"),
        ("step_mm 10.0", "step_mm inf"),
        ("step_mm 10.0", "step_mm 1e999"),
        ("resolution_mm 0.0001", "resolution_mm 0"),
        ("0 0 0\n", "0 0 99999999999\n"),
        ("0 0 0\n", "0 0  0\n"),
        ("0 0 0\n", ""),
        ("0 0 0\n", "0 0 0\n\n"),
    ],
)
def test_inconsistent_files_are_refused(library: ctypes.CDLL, old: str, new: str) -> None:
    assert old in BODY
    body = BODY.replace(old, new, 1)
    assert read(library, f"{body}file_crc32 {zlib.crc32(body.encode()):08X}\n") == MALFORMED


def test_corrections_too_large_or_too_steep_are_refused(library: ctypes.CDLL) -> None:
    counts = np.full((2, 2, 2, 3), 10000, dtype=np.int32)
    assert read(library, format_table(TableImage((0.0,) * 3, (10.0,) * 3, 1e-4, counts))) == OK
    assert read(library, format_table(TableImage((0.0,) * 3, (10.0,) * 3, 1e-4, counts + 1))) == BEYOND_LIMITS
    counts[1, 0, 0, 2] = -1
    assert read(library, format_table(TableImage((0.0,) * 3, (10.0,) * 3, 1e-4, counts))) == BEYOND_LIMITS
    counts[1, 0, 0, 2] = 0
    assert read(library, format_table(TableImage((0.0,) * 3, (10.0,) * 3, 1e-4, counts))) == OK
