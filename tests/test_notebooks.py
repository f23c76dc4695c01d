"""The notebooks in examples/ run, and their results are those that they show."""

import re

import pytest
from repository import EXAMPLES

missing = "nbclient, an optional extra, is not installed"
nbformat = pytest.importorskip("nbformat", reason=missing)
nbclient = pytest.importorskip("nbclient", reason=missing)
for extra in ("ipykernel", "pandas"):
    missing = f"{extra}, an optional extra, is not installed"
    pytest.importorskip(extra, reason=missing)

NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


def list_outputs(notebook):
    """Return what each cell shows.

    Its tables and texts as words, of figures only which kinds there are.
    """
    cell_outputs = []
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            assert output.output_type in ("execute_result", "display_data", "stream"), (
                output
            )
            data = output.get("data", {"text/plain": output.get("text", "")})
            words = re.sub(r"<\w+ at 0x\w+>", "", data["text/plain"]).split()
            table = re.sub(
                r'(?s)<style.*?</style>|src="data:[^"]*"', "", data.get("text/html", "")
            ).split()
            cell_outputs.append(
                (cell.id, output.get("name"), sorted(data), words, table)
            )
    return cell_outputs


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_shows_what_it_gives(path, tmp_path):
    stored = nbformat.read(path, as_version=4)
    run = nbformat.read(path, as_version=4)
    for cell in run.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(run, timeout=1000, resources=resources).execute()
    outputs = list_outputs(stored)
    assert list_outputs(run) == outputs
    assert "stderr" not in {name for _, name, *_ in outputs}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_as_run_small_and_names_no_machine(path):
    text = path.read_text("utf-8")
    assert len(text) < 1_500_000
    text = re.sub(
        r"[A-Za-z0-9+/=]{200,}", "", text.replace("\\n", "")
    )  # pictures, which are in base64
    traces = r"/home/|/root|/tmp|/Users/|\b20\d\d-\d\d-\d\dT|iopub|<iframe"
    assert not re.search(traces, text)
    cells = nbformat.read(path, as_version=4).cells
    codes = [cell for cell in cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in codes] == list(range(1, len(codes) + 1))
    outputs = [output for cell in codes for output in cell.outputs]
    kinds = {kind for output in outputs for kind in output.get("data", ())}
    assert {"text/html", "image/svg+xml", "image/png"} <= kinds


def test_there_is_a_notebook():
    assert NOTEBOOKS
