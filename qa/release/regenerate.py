"""Write what is made from the code anew: `make generated`.

python qa/release/regenerate.py
python qa/release/regenerate.py parameters
"""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
from reference import REFERENCES

from barn_eval.api.worlds import generate

ROOT = Path(__file__).resolve().parents[2]
# By name what `barn worlds generate` is told. barn300 is numbered by measured times:
# barn_worlds/README.md says how.
DATA_SETS: dict[str, dict[str, Any]] = {
    "barn_tb4": {"robot": "turtlebot4", "seed": 4, "keep": 100}
}


# The search for hard worlds is a tool of its own; its defaults give the shipped file.
HARD_WORLDS = "barn_hard"
HARD_WORLDS_TOOL = ROOT / "qa/studies/hard_worlds/generate_hard_worlds.py"


def write_data_set(name: str, folder: Path) -> Path:
    """Write a shipped data set and its manifest in place of the old ones."""
    target = folder / f"{name}.npz"
    target.unlink(missing_ok=True)
    if name == HARD_WORLDS:
        subprocess.run([sys.executable, HARD_WORLDS_TOOL, target], check=True)
    else:
        generate(target, **DATA_SETS[name])
    return target


def run_notebook(path: Path) -> None:
    """Run a notebook in an empty folder and keep its results in it.

    What depends on the machine is left out.
    """
    import nbformat  # noqa: PLC0415 (optional)
    from nbclient import NotebookClient  # noqa: PLC0415

    notebook = nbformat.read(path, as_version=4)
    metadata = dict(notebook.metadata)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook, record_timing=False, resources={"metadata": {"path": folder}}
        ).execute()
    notebook.metadata = metadata
    nbformat.write(notebook, path)


@click.command()
@click.argument(
    "parts", nargs=-1, type=click.Choice(["parameters", "worlds", "notebooks"])
)
def main(parts: Sequence[str]) -> None:
    """Write PARTS anew, all without any.

    parameters: the parameter tables of all READMEs and the parameter files. worlds:
    shipped data sets that one command makes. notebooks: the results in the notebooks of
    examples/, which need `make extras`.
    """
    for package, build_reference in (
        REFERENCES.items() if not parts or "parameters" in parts else ()
    ):
        build_reference().write(ROOT / package)
    for name in (*DATA_SETS, HARD_WORLDS) if not parts or "worlds" in parts else ():
        write_data_set(name, ROOT / "barn_worlds" / "barn_worlds" / "data")
    if parts and "notebooks" not in parts:
        return
    if find_spec("nbclient") is None or find_spec("ipykernel") is None:
        sys.exit(
            "the notebooks were left as they are: nbclient and ipykernel are not installed (make extras)"
        )
    for notebook in sorted((ROOT / "examples").glob("*.ipynb")):
        run_notebook(notebook)


if __name__ == "__main__":
    main()
