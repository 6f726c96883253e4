"""The notebooks: paired and stripped, and at smoke size they run from top to bottom and show pictures."""

import os
from pathlib import Path

import pytest

jupytext = pytest.importorskip("jupytext")

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("[0-9][0-9]_*.py"))
FIRST = NOTEBOOKS[0]
# A first cell that makes `import ipywidgets` raise ImportError.
HIDE_WIDGETS = 'import sys\n\nsys.modules["ipywidgets"] = None'


def stem(path):
    return path.stem


def cells_of(path):
    return [(cell.cell_type, cell.source) for cell in jupytext.read(path).cells]


def code_of(path):
    return [cell for cell in jupytext.read(path).cells if cell.cell_type == "code"]


def executed(path, first=None):
    """The notebook of a .py source, executed at smoke size on the package of this checkout."""
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = jupytext.read(path)
    if first is not None:
        notebook.cells.insert(0, jupytext.reads("# %%\n" + first, fmt="py:percent").cells[0])
    path_of_package = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    env = {**os.environ, "QSMC_SMOKE": "1", "PYTHONPATH": path_of_package}
    resources = {"metadata": {"path": str(path.parent)}}
    client = nbclient.NotebookClient(notebook, timeout=90, resources=resources)
    try:
        client.execute(env=env)
    except nbclient.exceptions.CellTimeoutError:
        # Seen twice in some thirty runs, in notebook 01 on a busy machine: a kernel that waits for ever. Not
        # understood: once more, in a new one.
        client.execute(env=env)
    return notebook


def pictures(notebook):
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [output for output in outputs if "image/png" in output.get("data", {})]


def test_there_are_five_notebooks_each_in_both_forms():
    assert [path.stem[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05"]
    assert sorted(p.stem for p in (ROOT / "notebooks").glob("*.ipynb")) == [p.stem for p in NOTEBOOKS]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=stem)
def test_both_forms_have_the_same_cells(path):
    assert cells_of(path.with_suffix(".ipynb")) == cells_of(path)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=stem)
def test_the_committed_notebook_is_stripped(path):
    cells = code_of(path.with_suffix(".ipynb"))
    assert [cell.outputs for cell in cells] == [[]] * len(cells)
    assert [cell.execution_count for cell in cells] == [None] * len(cells)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=stem)
def test_a_notebook_runs_from_top_to_bottom_and_shows_pictures(path):
    assert pictures(executed(path))


@pytest.mark.slow
def test_without_widgets_there_is_a_picture_in_place_of_the_sliders():
    notebook = executed(FIRST, first=HIDE_WIDGETS)
    (cell,) = [cell for cell in notebook.cells if "ipywidgets.interact" in cell.source]
    assert any("image/png" in output.get("data", {}) for output in cell.outputs)
