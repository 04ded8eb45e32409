"""The notebook runs."""

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

from conftest import ROOT

NOTEBOOK = ROOT / "docs/notebooks/python.ipynb"


def executed(notebook, folder):
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    return notebook


def test_the_notebook_runs(tmp_path):
    notebook = executed(nbformat.read(NOTEBOOK, as_version=4), tmp_path)
    made = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    data = [output.get("data", {}) for output in made]
    assert sum("image/png" in d for d in data) == 2 and any("<table>" in d.get("text/html", "") for d in data)
    assert any("filmed" in output.get("text", "") for output in made)


def test_a_line_that_fails_is_seen(tmp_path):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    notebook.cells = [nbformat.v4.new_code_cell("import blindaug as ba\nba.estimate([])")]
    with pytest.raises(CellExecutionError, match="there is no frame"):
        executed(notebook, tmp_path)


def test_the_notebook_is_kept_without_results():
    cells = nbformat.read(NOTEBOOK, as_version=4).cells
    assert all(not cell.outputs and cell.execution_count is None for cell in cells if cell.cell_type == "code")
