"""The notebooks of the gallery run as they stand, and what is stored in them is what comes of them today."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

GALLERY = Path(__file__).parents[2] / "docs" / "notebooks"
MOST_BYTES = 100_000
_DRAWN = re.compile(r"<svg.*?</svg>", re.DOTALL)


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Settings of a kernel that leaves nothing behind; a folder to work in."""
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "jupyter"))
    work = tmp_path / "work"
    work.mkdir()
    return work


def said(notebook):
    """What stands below each cell, but for how pictures are drawn."""
    return [[shown(output) for output in cell.outputs] for cell in notebook.cells if "outputs" in cell]


def shown(output):
    """What an output says, kind by kind."""
    kinds = {"text": output.text} if output.output_type == "stream" else output.data
    return {kind: None if "image" in kind else _DRAWN.sub("<svg>", what) for kind, what in kinds.items()}


def ran(path, folder):
    """A notebook after it was run from its first cell to its last."""
    notebook = nbformat.read(path, as_version=4)
    about = notebook.metadata.copy()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    where = {"metadata": {"path": str(folder)}}
    client = NotebookClient(notebook, timeout=60, record_timing=False, coalesce_streams=True, resources=where)
    client.execute()
    notebook.metadata = about  # which names no version of Python
    return notebook


@pytest.mark.parametrize("name", ["first_run", "break_and_explain", "your_law"])
def test_a_notebook_runs_and_says_what_is_stored_in_it(name, kernel, request):
    path = GALLERY / f"{name}.ipynb"
    stored, now = nbformat.read(path, as_version=4), ran(path, kernel)
    if request.config.getoption("--write"):
        nbformat.write(now, path)
        stored = nbformat.read(path, as_version=4)
    assert said(now) == said(stored), f"`pytest --write {request.node.nodeid}`"
    assert any(said(stored))
    assert path.stat().st_size < MOST_BYTES


def test_no_notebook_is_left_out():
    assert {path.stem for path in GALLERY.iterdir()} == {"first_run", "break_and_explain", "your_law"}
