"""The notebooks in examples/ run, and their results are those that they show."""

import re
from pathlib import Path

import pytest

nbformat = pytest.importorskip(
    "nbformat", reason="nbclient, an optional extra, is not installed"
)
nbclient = pytest.importorskip(
    "nbclient", reason="nbclient, an optional extra, is not installed"
)
pytest.importorskip(
    "ipykernel", reason="ipykernel, an optional extra, is not installed"
)
pytest.importorskip("pandas", reason="pandas, an optional extra, is not installed")

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
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
    assert list_outputs(run) == list_outputs(stored)
    assert not any(
        output.get("name") == "stderr"
        for cell in stored.cells
        for output in cell.get("outputs", ())
    )


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_as_run_small_and_names_no_machine(path):
    text = path.read_text("utf-8")
    assert len(text) < 1_500_000
    text = re.sub(
        r"[A-Za-z0-9+/=]{200,}", "", text.replace("\\n", "")
    )  # pictures, which are in base64
    for trace in (
        r"/home/",
        r"/root",
        r"/tmp",
        r"/Users/",
        r"\b20\d\d-\d\d-\d\dT",
        "iopub",
        "<iframe",
    ):
        assert not re.search(trace, text), trace
    codes = [
        cell
        for cell in nbformat.read(path, as_version=4).cells
        if cell.cell_type == "code"
    ]
    assert [cell.execution_count for cell in codes] == list(range(1, len(codes) + 1))
    kinds = {
        kind
        for cell in codes
        for output in cell.outputs
        for kind in output.get("data", ())
    }
    assert {"text/html", "image/svg+xml", "image/png"} <= kinds


def test_there_is_a_notebook():
    assert NOTEBOOKS
