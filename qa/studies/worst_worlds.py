"""Draw for each planner the world in which it falls furthest behind the others.

The figures are those of docs/boards.md.

    python qa/studies/worst_worlds.py out/barn300 docs/figures

All trajectories of that world are drawn; how far a planner is behind is the mean
efficiency of the others less its own.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

import barn_eval as barn
from barn_worlds.base.errors import BarnError

_SIZE_IN = (3.2, 6.4)
# From the start to the goal.
_SHOWN_M = (2.4, 13.4)


def worst_worlds(folders: Sequence[Path]) -> dict[str, int]:
    """Return the number of the world by planner.

    Of worlds that are equally bad for it, the first.
    """
    table = pd.concat([barn.load(folder).table for folder in folders])
    efficiency = table.pivot_table(
        index="world", columns="planner", values="efficiency", aggfunc="mean"
    ).dropna()
    total = efficiency.sum(axis=1).to_numpy()[:, None]
    mean_of_others = (total - efficiency) / (efficiency.shape[1] - 1)
    return {
        str(planner): int(world)
        for planner, world in (mean_of_others - efficiency).idxmax().items()
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Write worst_PLANNER.png for each planner and say which worlds they are."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "results", type=Path, nargs="+", help="folders of runs in the same worlds"
    )
    parser.add_argument("figures", type=Path, help="the folder that the pictures go to")
    options = parser.parse_args(arguments)
    try:
        for planner, world in worst_worlds(options.results).items():
            path = options.figures / f"worst_{planner}.png"
            overlay = barn.results.overlay(options.results, world)
            overlay.figure.legends[0].remove()  # the page says whose color is whose
            overlay.figure.set_size_inches(_SIZE_IN)
            overlay.figure.axes[0].set_ylim(*_SHOWN_M)
            overlay.save(path)
            print(f"{path}: world {world}")
    except BarnError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
