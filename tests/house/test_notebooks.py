"""The notebooks: paired and stripped, and at smoke size they run from top to bottom and show pictures."""

import os
import re

import pytest

import places

jupytext = pytest.importorskip("jupytext")

ROOT = places.ROOT
NOTEBOOKS = sorted((ROOT / "notebooks").glob("[0-9][0-9]_*.py"))
FIRST = NOTEBOOKS[0]
# A first cell that makes `import ipywidgets` raise ImportError.
HIDE_WIDGETS = 'import sys\n\nsys.modules["ipywidgets"] = None'


def stem(path):
    return path.stem


def cells_of(path):
    return [(cell.cell_type, cell.source) for cell in jupytext.read(path).cells]


def code_of(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


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
    client = nbclient.NotebookClient(notebook, timeout=300, resources=resources)
    # Widgets that capture output are not mimicked, so that it stays in the cell. To answer them, nbclient sends on the
    # channel on which it waits for the end of the cell, and then may never see it (jupyter/nbclient#312).
    client.widget_registry = {}
    client.execute(env=env)
    return notebook


def shows_picture(cell):
    return any("image/png" in output.get("data", {}) for output in cell.outputs)


def draws(cell):
    return re.search(r"\.plot\w*\(|\.subplots\(|interact\(", cell.source) is not None


def test_there_are_six_notebooks_each_in_both_forms():
    assert [path.stem[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05", "06"]
    assert sorted(p.stem for p in (ROOT / "notebooks").glob("*.ipynb")) == [p.stem for p in NOTEBOOKS]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=stem)
def test_both_forms_have_the_same_cells(path):
    assert cells_of(path.with_suffix(".ipynb")) == cells_of(path)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=stem)
def test_the_committed_notebook_is_stripped(path):
    cells = code_of(jupytext.read(path.with_suffix(".ipynb")))
    assert [cell.outputs for cell in cells] == [[]] * len(cells)
    assert [cell.execution_count for cell in cells] == [None] * len(cells)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=stem)
def test_a_notebook_runs_from_top_to_bottom_and_shows_pictures(path):
    drawing = [cell for cell in code_of(executed(path)) if draws(cell)]
    assert len(drawing) >= 2
    assert [cell.source for cell in drawing if not shows_picture(cell)] == []


@pytest.mark.slow
def test_without_widgets_there_is_a_picture_in_place_of_the_sliders():
    notebook = executed(FIRST, first=HIDE_WIDGETS)
    (cell,) = [cell for cell in notebook.cells if "ipywidgets.interact" in cell.source]
    assert shows_picture(cell)
