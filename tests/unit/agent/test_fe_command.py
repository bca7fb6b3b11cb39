"""`volcal fe` as it is called: results written here, in other frames and units, come back as the grid they were."""

from __future__ import annotations

import base64
import json
import re
import resource
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import meshio
import numpy as np
import pytest
from click.testing import CliRunner, Result

from agent.cli.main import main
from twin.formats.deflection_file import parse_deflection

ROOT = Path(__file__).parents[3]
MACHINE = ROOT / "config" / "machines" / "case-study.toml"
NODES = (np.array([0.0, 2000.0, 4000.0]), np.array([0.0, 600.0, 1300.0]), np.array([0.0, 800.0, 1500.0]))
AXES = np.stack(np.meshgrid(*NODES, indexing="ij"), axis=-1).reshape(-1, 3)


def field_um(at: np.ndarray) -> np.ndarray:
    """Return displacements (n, 3) in µm at axis positions in mm, in machine axes; zero in the middle."""
    x, y, z = (at - (2000.0, 600.0, 800.0)).T / 1000.0
    return np.stack((x + y * z, 5.0 * y * z, -8.0 * y - y**2), axis=1)


def call(*words: object) -> Result:
    return CliRunner().invoke(main, ["fe", *map(str, words)], catch_exceptions=False)


def grid_um(file: Path) -> np.ndarray:
    return 1e3 * parse_deflection(file.read_text(), file.name).at(AXES)


def in_model(vectors: np.ndarray) -> np.ndarray:
    """Return machine vectors in a model whose y points upwards and whose z points against the machine's Y."""
    x, y, z = vectors.T
    return np.stack((x, z, -y), axis=1)


FRAME = ("--frame", "X=+x,Y=-z,Z=+y")
REFERENCE = ("--reference", "2000,600,800")


def write_positions(folder: Path, *columns: str, rows: list[str] | None = None) -> Path:
    rows = rows or [str(number) for number in range(1, len(AXES) + 1)]
    lines = [",".join(("x_mm,y_mm,z_mm", *columns))]
    lines += [f"{x:g},{y:g},{z:g},{row}" for (x, y, z), row in zip(AXES, rows, strict=True)]
    path = folder / "positions.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_listing(path: Path, moved: np.ndarray, left_out: int | None = None) -> None:
    """Write one load step for each displacement (n, 3), in m, with a second node that does not matter."""
    pages = []
    for step, values in enumerate(moved.tolist(), start=1):
        if step != left_out:
            numbers = "".join(f"{value:12.5E}" for value in (*values, float(np.linalg.norm(values))))
            pages.append(
                f"  LOAD STEP= {step:5d}  SUBSTEP=     1\n   TIME=    1.0000      LOAD CASE=   0\n\n"
                "  THE FOLLOWING DEGREE OF FREEDOM RESULTS ARE IN THE GLOBAL COORDINATE SYSTEM\n\n"
                "    NODE       UX           UY           UZ           USUM\n"
                f"     900 {0.5:12.5E}{0.5:12.5E}{0.5:12.5E}{0.75**0.5:12.5E}\n     901 {numbers}\n\n"
            )
    path.write_text("".join(pages))


def test_a_listing_in_metres_and_in_the_frame_of_the_model(tmp_path: Path) -> None:
    listing, out = tmp_path / "r.lis", tmp_path / "grid.csv"
    write_listing(listing, in_model(1e-6 * field_um(AXES)))
    positions = write_positions(tmp_path, "load_step")
    common = ("import", listing, "--positions", positions, *FRAME, "-o", out, *REFERENCE)
    done = call(*common, "--unit", "m", "--node", 901, "--machine", MACHINE, "--figure", tmp_path / "grid.png")
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(grid_um(out), field_um(AXES), atol=2e-4)
    assert (tmp_path / "grid.png").read_bytes().startswith(b"\x89PNG")
    wrong = call(*common, "--unit", "mm", "--node", 901)
    assert wrong.exit_code == 2
    assert "In m they would be plausible" in wrong.stderr
    assert "that of the tool point is not stated" in call(*common, "--unit", "m").stderr


def test_a_missing_load_step_is_named_or_interpolated(tmp_path: Path) -> None:
    listing, out = tmp_path / "r.lis", tmp_path / "grid.csv"
    middle = 14
    np.testing.assert_array_equal(AXES[middle - 1], (2000.0, 600.0, 800.0))
    write_listing(listing, 1e-6 * field_um(AXES), left_out=middle)
    positions = write_positions(tmp_path, "load_step")
    common = ("import", listing, "--positions", positions, "--unit", "m", "--node", 901, "-o", out)
    refused = call(*common)
    assert refused.exit_code == 2
    assert "load step 14 (X 2000, Y 600, Z 800)" in refused.stderr
    assert not out.exists()
    filled = call(*common, "--fill-missing", "--reference", "none")
    assert filled.exit_code == 0, filled.output
    assert "warning: interpolated X 2000, Y 600, Z 800 mm" in filled.stderr
    assert np.abs(grid_um(out) - field_um(AXES))[middle - 1].max() < 0.2  # the square of y, linearly


@pytest.mark.parametrize("plane", [4000.0, 2000.0, 0.0])
def test_a_whole_plane_without_results_stays_in_the_grid(tmp_path: Path, plane: float) -> None:
    """No node disappears with its results: a fifth at most is interpolated, and no end of the grid."""
    xs = np.arange(0.0, 4001.0, 500.0) if plane == 4000.0 else NODES[0]
    axes = np.stack(np.meshgrid(xs, *NODES[1:], indexing="ij"), axis=-1).reshape(-1, 3)
    positions, results, out = tmp_path / "p.csv", tmp_path / "r.csv", tmp_path / "g.csv"
    lines = [f"{x:g},{y:g},{z:g},{step}" for step, (x, y, z) in enumerate(axes, start=1)]
    positions.write_text("\n".join(("x_mm,y_mm,z_mm,load_step", *lines, "")))
    moved = enumerate(zip(axes[:, 0], field_um(axes), strict=True), start=1)
    rows = [f"{step},{u:g},{v:g},{w:g}" for step, (x, (u, v, w)) in moved if x != plane]
    results.write_text("\n".join(("load_step,ux,uy,uz", *rows, "")))
    done = call("import", results, "--positions", positions, "--unit", "um", "--fill-missing", "-o", out)
    assert done.exit_code == 2
    says = "does not lie between others" if plane == 4000.0 else "9 of 27 positions of the 3 x 3 x 3 grid are missing"
    assert says in " ".join(done.stderr.split())
    assert not out.exists()


def test_a_csv_file_with_rotations_and_a_tool_beyond_the_node(tmp_path: Path) -> None:
    """The node is 250 mm behind the tool point; its rotation carries the rest."""
    turned, offset = np.array([20e-6, -10e-6, 5e-6]), np.array([0.0, 250.0, 0.0])
    factor = (1.0 + AXES[:, 1:2] / 1300.0) * turned
    node = 1e-3 * field_um(AXES) - np.cross(factor, offset)
    rows = [",".join(f"{value:.12g}" for value in row) for row in np.hstack((AXES, in_model(node), in_model(factor)))]
    results, out = tmp_path / "r.csv", tmp_path / "grid.csv"
    results.write_text("x_mm,y_mm,z_mm,ux,uy,uz,rotx,roty,rotz\n" + "\n".join(rows) + "\n")
    done = call("import", results, "--unit", "mm", *FRAME, "--offset", "0,250,0", "-o", out, *REFERENCE)
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(grid_um(out), field_um(AXES), atol=2e-4)
    fine = call("import", results, "--unit", "mm", *FRAME, "-o", out, "--resample", "5x7x9", "--remove-rigid")
    assert "5 x 7 x 9 nodes" in fine.stdout


@pytest.mark.parametrize("suffix", ["vtu", "vtk"])
@pytest.mark.parametrize("way", [("--within", "0.5"), ("--interpolate",)], ids=["nearest", "interpolated"])
def test_meshes_whose_field_is_linear(tmp_path: Path, suffix: str, way: tuple[str, ...]) -> None:
    """One mesh for each position; the probe moves with the tool and is read where the field is known."""
    line = np.linspace(-20.0, 20.0, 5)
    corners = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    tetra = [("tetra", np.array([[0, 1, 5, 25]]))]
    gradient = np.array([[1.0, 2.0, 0.0], [0.0, -1.0, 3.0], [0.5, 0.0, 1.0]]) * 1e-5
    at = np.array([0.0, 10.0, 0.0]) if "--within" in way else np.array([3.0, 7.0, -4.0])
    files, rows = [], []
    for number, moved in enumerate(1e-3 * field_um(AXES)):
        probe = at + 100.0 * number
        values = moved + (corners - at) @ gradient.T
        path = tmp_path / f"p{number}.{suffix}"
        meshio.Mesh(corners + 100.0 * number, tetra, point_data={"displacement": values}).write(path)
        files.append(path)
        rows.append(f"{path.name},{probe[0]},{probe[1]},{probe[2]}")
    positions = write_positions(tmp_path, "file", "probe_x", "probe_y", "probe_z", rows=rows)
    out = tmp_path / "grid.csv"
    done = call("import", *files, "--positions", positions, "--unit", "mm", *way, "-o", out, *REFERENCE)
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(grid_um(out), field_um(AXES), atol=2e-4)


def write_mesh(tmp_path: Path, values: np.ndarray, name: str = "displacement") -> Path:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    path = tmp_path / "m.vtu"
    meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))], point_data={name: values}).write(path)
    return path


@pytest.mark.parametrize(
    ("options", "name", "value", "says"),
    [
        (("--probe", "5,5,5"), "displacement", 0.0, "the nearest node is"),
        (("--probe", "5,5,5", "--interpolate"), "displacement", 0.0, "do not enclose this point"),
        (("--probe", "0,0,0"), "displacement", np.nan, "is not finite"),
        (("--probe", "0,0,0"), "stress", 0.0, "no displacements as point data"),
        (("--probe", "0,0,0", "--displacement", "U"), "displacement", 0.0, "no point data 'U'"),
        ((), "displacement", 0.0, "the place at which the mesh is read is not stated"),
    ],
)
def test_meshes_without_a_result(tmp_path: Path, options: tuple[str, ...], name: str, value: float, says: str) -> None:
    mesh = write_mesh(tmp_path, np.full((4, 3), value), name)
    positions = tmp_path / "p.csv"
    positions.write_text(f"x_mm,y_mm,z_mm,file\n0,0,0,{mesh.name}\n")
    done = call("import", mesh, "--positions", positions, "--unit", "mm", *options, "-o", tmp_path / "g.csv")
    assert done.exit_code == 2
    assert says in done.stderr


@pytest.mark.parametrize("content", [b"", b"<VTKFile", b"# vtk DataFile Version 5.1\nx\nBINARY\nDATASET NOTHING\n"])
@pytest.mark.parametrize("name", ["m.vtu", "m.vtk", "m.msh", "m.unknown"])
def test_broken_meshes(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    positions = tmp_path / "p.csv"
    positions.write_text("x_mm,y_mm,z_mm\n0,0,0\n")
    words = ("--positions", positions, "--unit", "mm", "--probe", "0,0,0", "-o", tmp_path / "g.csv")
    done = call("import", tmp_path / name, *words)
    assert done.exit_code == 2
    assert "meshio cannot read the mesh" in done.stderr


def test_a_small_file_does_not_unpack_to_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """600 MB of zeros in a file below 1 MB, where a mesh may take 200 MB. The bound ends with the reading."""
    block, count = zlib.compress(bytes(20_000_000), 9), 30
    header = struct.pack(f"<{3 + count}I", count, 20_000_000, 0, *[len(block)] * count)
    content = base64.b64encode(header).decode() + base64.b64encode(block * count).decode()
    array = f'<DataArray type="Float64" Name="Points" NumberOfComponents="3" format="binary">{content}</DataArray>'
    (tmp_path / "m.vtu").write_text(
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">'
        f'<UnstructuredGrid><Piece NumberOfPoints="25000000" NumberOfCells="0"><Points>{array}</Points></Piece>'
        "</UnstructuredGrid></VTKFile>"
    )
    monkeypatch.setattr("agent.finite_elements.mesh_results._MEMORY_BYTES", 200_000_000)
    before = resource.getrlimit(resource.RLIMIT_AS)
    positions = tmp_path / "p.csv"
    positions.write_text("x_mm,y_mm,z_mm\n0,0,0\n")
    words = ("--positions", positions, "--unit", "mm", "--probe", "0,0,0", "-o", tmp_path / "g.csv")
    done = call("import", tmp_path / "m.vtu", *words)
    assert done.exit_code == 2
    assert "the mesh needs more than 0.2 GB of memory" in done.stderr
    assert resource.getrlimit(resource.RLIMIT_AS) == before


def write_meshes_in_metres(folder: Path) -> Path:
    """Write a mesh in metres whose nodes lie at all axis positions, and a table that reads each position there."""
    tetra = [("tetra", np.array([[0, 1, 3, 9]]))]
    meshio.Mesh(AXES / 1000.0, tetra, point_data={"displacement": 1e-6 * field_um(AXES)}).write(folder / "m.vtu")
    rows = [f"m.vtu,{x / 1000 + 0.001},{y / 1000},{z / 1000}" for x, y, z in AXES]
    return write_positions(folder, "file", "probe_x", "probe_y", "probe_z", rows=rows)


def test_near_means_near_in_the_unit_of_the_mesh(tmp_path: Path) -> None:
    """1 mm beside a node of a mesh of 4 m is near, 0.3 m is not; the node that was read is named."""
    out = tmp_path / "g.csv"
    positions = write_meshes_in_metres(tmp_path)
    common = ("import", tmp_path / "m.vtu", "--positions", positions, "--unit", "m", "-o", out, *REFERENCE)
    done = call(*common)
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(grid_um(out), field_um(AXES), atol=2e-4)
    assert re.search(r"node \d+ of m.vtu at \(\d, \S+, \S+\), 0.001 from the point", done.stderr)
    positions.write_text(positions.read_text().replace(",0.001,0.6,0.8", ",0.301,0.6,0.8"))
    far = call(*common)
    assert far.exit_code == 2
    assert "the nearest node is 0.301 away from (0.301, 0.6, 0.8), more than 0.004465" in far.stderr
    assert "node 5 of m.vtu at (0, 0.6, 0.8), 0.301 from the point" in call(*common, "--within", "0.5").stderr
    for number in ("nan", "inf"):
        assert "must be a finite number" in " ".join(call(*common, "--within", number).stderr.split())


def test_no_output_replaces_a_file_that_is_read(tmp_path: Path) -> None:
    positions = write_meshes_in_metres(tmp_path)
    mesh, before = tmp_path / "m.vtu", (tmp_path / "m.vtu").read_bytes()
    common = ("import", mesh, "--positions", positions, "--unit", "m")
    grid = tmp_path / "g.png"
    for options in (
        ("-o", mesh),
        ("-o", tmp_path / "." / ".." / tmp_path.name / "positions.csv"),
        ("-o", grid, "--figure", grid),
    ):
        done = call(*common, *options)
        assert done.exit_code == 2
        assert "would replace a file" in " ".join(done.stderr.split())
    assert mesh.read_bytes() == before
    structure = coarse(tmp_path)
    assert "would replace a file" in " ".join(call("model", structure, "-o", structure).stderr.split())
    compared = tmp_path / "grid.svg"
    compared.write_text("grid")
    done = call("compare", compared, "--machine", MACHINE, "--figure", compared)
    assert "would replace a file" in " ".join(done.stderr.split())


def write_results(folder: Path) -> Path:
    path = folder / "r.csv"
    rows = [",".join(f"{number:g}" for number in row) for row in np.hstack((AXES, field_um(AXES)))]
    path.write_text("x_mm,y_mm,z_mm,ux,uy,uz\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    "options",
    [
        ("--node", "3"),
        ("--probe", "0,0,0"),
        ("--within", "1"),
        ("--interpolate",),
        ("--displacement", "U"),
        ("--rotation", "UR"),
    ],
)
def test_options_without_a_use_are_refused(tmp_path: Path, options: tuple[str, ...]) -> None:
    done = call("import", write_results(tmp_path), "--unit", "um", "-o", tmp_path / "g.csv", *options)
    assert done.exit_code == 2
    assert f"{options[0]} is for" in done.stderr
    assert not (tmp_path / "g.csv").exists()


def test_near_and_between_exclude_each_other(tmp_path: Path) -> None:
    positions = write_meshes_in_metres(tmp_path)
    words = ("--positions", positions, "--unit", "m", "--within", "1", "--interpolate", "-o", tmp_path / "g.csv")
    assert "exclude each other" in call("import", tmp_path / "m.vtu", *words).stderr


def test_headers_of_spreadsheets(tmp_path: Path) -> None:
    results, out = write_results(tmp_path), tmp_path / "g.csv"
    text = results.read_text()
    common = ("import", results, "--unit", "um", "-o", out, *REFERENCE)
    results.write_text(text.replace("x_mm,y_mm", '"x_mm","y_mm"'))
    assert call(*common).exit_code == 0
    np.testing.assert_allclose(grid_um(out), field_um(AXES), atol=2e-4)
    for separator, shown in ((";", ";"), ("\t", r"\t")):
        results.write_text(text.replace(",", separator))
        done = call(*common)
        assert done.exit_code == 2
        assert f"separated by '{shown}', not by commas" in done.stderr


def test_grids_of_the_same_name_have_a_row_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    monkeypatch.setattr("agent.cli.offline_commands.fe._draw", lambda _, grids, *__: drawn.extend(grids))
    files = [tmp_path / folder / "grid.csv" for folder in ("a", "b")]
    for file in files:
        file.parent.mkdir()
        shutil.copy(MACHINE.with_name("case-study-deflection.csv"), file)
    done = call("compare", *files, "--machine", MACHINE, "--figure", tmp_path / "f.png")
    assert done.exit_code == 0, done.output
    assert drawn == [str(file) for file in files]


def test_results_without_positions_and_files_without_results(tmp_path: Path) -> None:
    listing, other = tmp_path / "r.lis", tmp_path / "s.lis"
    write_listing(listing, 1e-6 * field_um(AXES))
    write_listing(other, 1e-6 * field_um(AXES))
    out = ("--unit", "m", "--node", 901, "-o", tmp_path / "g.csv")
    assert "do not contain the axis positions" in call("import", listing, *out).stderr
    positions = write_positions(tmp_path, "load_step")
    assert "which file it means" in call("import", listing, other, "--positions", positions, *out).stderr
    few = write_positions(tmp_path, "file", rows=["x.lis"] * len(AXES))
    assert "'x.lis' is not among the results" in call("import", listing, "--positions", few, *out).stderr
    unsaid = write_positions(tmp_path, "file", rows=["r.lis"] * len(AXES))
    assert "which of the 27 load steps" in call("import", listing, "--positions", unsaid, *out).stderr


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--reference", "centre", "neither middle nor none"),
        ("--reference", "0,0,9999", "outside the deflection grid"),
        ("--frame", "X=x,Y=z,Z=y", "left-handed"),
        ("--probe", "here", "is not X,Y,Z"),
        ("--resample", "9x15", "not three numbers of nodes"),
        ("--resample", "100x100x51", "510000 nodes are too many"),
        ("--figure", "grid.jpg", "'grid.jpg' must end with one of .png, .svg, .pdf"),
        ("--machine", "none.toml", "no such file"),
    ],
)
def test_options_that_say_nothing(tmp_path: Path, option: str, value: str, says: str) -> None:
    done = call("import", write_results(tmp_path), "--unit", "um", "-o", tmp_path / "g.csv", option, value)
    assert done.exit_code == 2
    assert says in " ".join(done.stderr.split())
    assert not (tmp_path / "g.csv").exists()


def test_unused_load_steps_are_a_warning(tmp_path: Path) -> None:
    listing, out = tmp_path / "r.lis", tmp_path / "g.csv"
    write_listing(listing, 1e-6 * np.concatenate((field_um(AXES), [[1.0, 1.0, 1.0]])))
    positions = write_positions(tmp_path, "load_step")
    done = call("import", listing, "--positions", positions, "--unit", "m", "--node", 901, "-o", out)
    assert done.exit_code == 0, done.output
    assert "no position uses load step 28 of r.lis" in done.stderr


STRUCTURE = ROOT / "config" / "structures" / "case-study.toml"


def coarse(tmp_path: Path) -> Path:
    text = STRUCTURE.read_text(encoding="utf-8")
    for old, new in (("4000.0, 9]", "4000.0, 2]"), ("1300.0, 15]", "1300.0, 3]"), ("1500.0, 13]", "1500.0, 3]")):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "structure.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_solid_model_becomes_a_grid_that_a_machine_reads(tmp_path: Path) -> None:
    out = tmp_path / "solid.csv"
    done = call("model", coarse(tmp_path), "--cells", 1, "-o", out, "--figure", tmp_path / "solid.svg")
    assert done.exit_code == 0, done.output
    assert "together" in done.stdout
    compared = call("compare", out, "--machine", MACHINE, "--json", "--figure", tmp_path / "compared.png")
    share = json.loads(compared.stdout)["grids"][str(out)]
    assert share["rest_um"] < 0.5 * share["without_series_um"] < share["aligned_um"] < share["raw_um"]
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE.read_text(encoding="utf-8").replace("case-study-deflection.csv", out.name))
    assert call("compare", out, "--machine", machine).exit_code == 0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("rib_pitch_mm = 400.0", "rib_pitch_mm = 160.0", "at most 1300 are solved"),
    ],
)
def test_structures_that_cannot_be_solved(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = coarse(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    done = call("model", path, "--cells", 3 if "pitch" in old else 1, "-o", tmp_path / "g.csv")
    assert done.exit_code == 2
    assert says in done.stderr


@pytest.mark.parametrize(
    ("module", "words"),
    [("skfem", ("model", STRUCTURE)), ("meshio", ("import", "m.vtu", "--unit", "mm", "--positions", "p.csv"))],
)
def test_without_the_optional_package(
    module: str, words: tuple[object, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)  # an import of it fails
    for name in ("machine_structure", "solid_part"):
        monkeypatch.delitem(sys.modules, f"agent.finite_elements.{name}", raising=False)
    Path("p.csv").write_text("x_mm,y_mm,z_mm,probe_x,probe_y,probe_z\n0,0,0,0,0,0\n")
    done = call(*words, "-o", "g.csv")
    assert done.exit_code == 2
    assert "pip install 'volcal[fe]'" in done.stderr


def test_the_service_loads_no_finite_elements() -> None:
    statement = "import agent.service.daemon.serve, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", statement], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = done.stdout.split()
    assert "agent.service.daemon.serve" in loaded
    assert not {"skfem", "meshio"} & set(loaded)
