"""The notebooks in docs/notebooks run from top to bottom with the library as it is, and use nothing but the library."""

from __future__ import annotations

import ast
import base64
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
import pytest
from jupyter_client.manager import AsyncKernelManager
from jupyter_core.utils import run_sync
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[3] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
PNG = b"\x89PNG\r\n\x1a\n"
ALLOWED = {"volcal", "numpy", "matplotlib", "pandas", "dataclasses", "math", "pathlib", "tempfile"}
LINK = re.compile(r"\]\(([^)\s#]+)[^)]*\)")


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def code_of(notebook: Any) -> str:
    return "\n\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")


def outputs_of(notebook: Any) -> list[Any]:
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def pictures_in(outputs: list[Any]) -> list[bytes]:
    return [base64.b64decode(output.data["image/png"]) for output in outputs if "image/png" in output.get("data", {})]


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AsyncKernelManager]:
    """One kernel for all notebooks: to start one and to import the library takes longer than most notebooks."""
    directory = tmp_path_factory.mktemp("jupyter")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "MPLCONFIGDIR"):
            patch.setenv(name, str(directory / name.lower()))
        patch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
        manager = AsyncKernelManager(kernel_name="python3")
        yield manager
        run_sync(manager.shutdown_kernel)(now=True)


def execute(notebook: Any, kernel: AsyncKernelManager, directory: Path) -> None:
    client = NotebookClient(notebook, km=kernel, timeout=600, resources={"metadata": {"path": str(directory)}})
    try:
        client.execute(cleanup_kc=False)
    finally:
        assert client.kc is not None
        client.kc.stop_channels()


@pytest.fixture
def executed(request: pytest.FixtureRequest, tmp_path: Path, kernel: AsyncKernelManager) -> Any:
    """Notebook that has run without anything that another has defined, in a directory of its own."""
    # First of all out of the directory of the notebook before, which is deleted: there nothing can be imported.
    emptied = f"import os\nos.chdir({str(tmp_path)!r})\nimport matplotlib\nmatplotlib.rcdefaults()\n%reset -f"
    execute(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(emptied)]), kernel, tmp_path)
    notebook = read(request.param)
    execute(notebook, kernel, tmp_path)
    return notebook


def by_name(path: Path) -> str:
    return path.stem


def test_there_are_ten_notebooks_in_their_order() -> None:
    assert [path.name[:3] for path in NOTEBOOKS] == [f"{number:02d}-" for number in range(1, 11)]


@pytest.mark.parametrize("executed", NOTEBOOKS, ids=by_name, indirect=True)
def test_a_notebook_runs_and_shows_pictures_without_warnings(executed: Any) -> None:
    outputs = outputs_of(executed)
    pictures = pictures_in(outputs)
    assert pictures
    assert all(picture.startswith(PNG) and len(picture) > 5000 for picture in pictures)
    assert [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"] == []
    shown = [output.data["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    if "vc.identify(balls, setup.machine" in code_of(executed):  # the estimate is the last value of its cell
        assert any("normalised χ²" in html and "data:image/png;base64," in html for html in shown)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=by_name)
def test_a_notebook_is_valid_and_stored_without_outputs(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert outputs_of(notebook) == []
    assert {cell.execution_count for cell in notebook.cells if cell.cell_type == "code"} == {None}
    assert set(notebook.metadata) == {"kernelspec", "language_info"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=by_name)
def test_a_notebook_imports_the_library_and_none_of_its_private_modules(path: Path) -> None:
    imported, used = set(), set()
    tree = ast.parse(code_of(read(path)))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module or "")
        elif isinstance(node, ast.Attribute):
            used.add(node.attr)
    assert {name.split(".")[0] for name in imported} <= ALLOWED
    assert [name for name in imported if name.startswith("volcal")] == ["volcal"]
    assert [name for name in used if name.startswith("_")] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=by_name)
def test_links_of_a_notebook_resolve(path: Path) -> None:
    text = "\n".join(cell.source for cell in read(path).cells if cell.cell_type == "markdown")
    links = [link for link in LINK.findall(text) if not link.startswith("http")]
    assert [link for link in links if not (FOLDER / link).exists()] == []


def test_the_list_of_documents_names_each_notebook() -> None:
    text = (FOLDER.parent / "README.md").read_text(encoding="utf-8")
    assert [path.name for path in NOTEBOOKS if f"(notebooks/{path.name})" not in text] == []
