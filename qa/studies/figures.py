"""Draw the figures of the documentation anew.

`make figures`, or python qa/studies/figures.py docs.

Figures of results are drawn from docs/results.json and docs/carry_over.csv, the others
from worlds. Those that need training, trials, or data that is not in the repository are
left as they are; the command that draws each is printed.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from carry_over import read_trials, scatter
from metrics_figures import draw_documentation_figures
from reproduction_page import read_results

from barn_eval.pages.figures import style, write_figure
from barn_eval.studies.reproduction.page import write_figures
from barn_worlds.base.errors import BarnError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.drawing.files import write_png
from barn_worlds.drawing.worlds import world_figure

# What draws the others.
ELSEWHERE = {
    "trial.gif": "make animation",
    "report.png": "the top of barn report out/first, after README.md",
    "barn_hard.png": "barn show 0:100:5 --dataset barn_hard --out docs/figures/barn_hard.png",
    "office.png": "barn show out/office.yaml --out docs/figures/office.png, after docs/tutorials/own_world.md",
    "garden.png": "barn show out/garden.map --out docs/figures/garden.png, after docs/tutorials/own_world.md",
    "routes.png": "barn show out/office.yaml --routes 12, after docs/tutorials/own_world.md",
    "maneuvers.png": "barn show 2:21:3 --dataset maneuvers --out docs/figures/maneuvers.png",
    "learning_curve.png": "python examples/train_policy.py, its curve.png (ten minutes)",
    **dict.fromkeys(
        [f"worst_{name}.png" for name in ("dwa", "eband", "gap", "mppi", "policy")],
        "python qa/studies/worst_worlds.py out/barn300 docs/figures, after docs/boards.md",
    ),
    **dict.fromkeys(
        [f"worst_nav2_{name}.png" for name in ("rpp", "dwb", "graceful", "mppi")],
        "python qa/studies/worst_worlds.py out/nav2_barn300 docs/figures, after docs/boards.md",
    ),
    **dict.fromkeys(
        ["latency.png", "latency_nav2.png"],
        "sweep of barn report, after docs/boards.md",
    ),
    "fidelity_defaults.png": (
        "python qa/fidelity/calibrate.py FOLDER --reference TABLE --figure,"
        " with the published times"
    ),
}


def draw_all(docs: Path) -> list[Path]:
    """Draw all figures that need no trials into docs/figures and return them.

    Raises:
        BarnError: If one cannot be drawn.
    """
    folder = docs / "figures"
    before = {path: path.stat().st_mtime_ns for path in folder.glob("*")}
    write_figures(read_results(docs)[0], folder)
    draw_documentation_figures(folder, open_dataset("barn300"))
    with style():
        write_figure(
            scatter(read_trials(docs / "carry_over.csv")), folder / "carry_over.png"
        )
    write_png(world_figure(open_dataset("dynabarn60").load(5)), folder / "dynabarn.png")
    return sorted(
        path for path in folder.glob("*") if before.get(path) != path.stat().st_mtime_ns
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the figures of a documentation folder."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "docs", type=Path, help="the folder with results.json, such as docs"
    )
    options = parser.parse_args(arguments)
    try:
        print(*draw_all(options.docs), sep="\n")
    except BarnError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for name, command in ELSEWHERE.items():
        print(f"{name} is left as it is: {command}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
