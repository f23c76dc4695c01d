"""Make the shipped data set dynabarn60 of the motions and worlds of DynaBARN.

    python qa/studies/dynabarn.py WORLDS.json

WORLDS.json has the profiles by name (period_s, radius_m, height_m, keys of s, m, m) and
the worlds with their difficulty and the names of their profiles.
"""

from pathlib import Path
from typing import Any

import click

from barn_worlds.base.errors import BarnError
from barn_worlds.base.files import read_json
from barn_worlds.datasets.generate_motion import build_arena
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.moving.motion import Motion, MovingObstacle
from barn_worlds.worlds.world import Provenance

TARGET = Path(__file__).parents[2] / "barn_worlds/barn_worlds/data/dynabarn60.npz"
LICENCE = "MIT, Copyright (c) 2022 Zifan Xu; see dynabarn60.LICENSE"
PAPER = (
    "Nair, Jiang, Hou, Xu, Li, Xiao, Stone: DynaBARN: Benchmarking Metric Ground Navigation in Dynamic Environments "
    "(SSRR 2022); worlds 300 to 359 of the BARN Challenge"
)


@click.command()
@click.argument("file", metavar="WORLDS.json", type=click.Path(path_type=Path))
def main(file: Path) -> None:
    """Write the shipped data set dynabarn60 from the motions in WORLDS.json."""
    try:
        content = read_json(file)
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    obstacles = {
        name: _obstacle(name, profile) for name, profile in content["profiles"].items()
    }
    worlds = {}
    for entry in content["worlds"]:
        index = entry["world"]
        provenance = Provenance(
            "original", parameters={"difficulty": entry["difficulty"]}
        )
        worlds[index] = build_arena(
            f"dynabarn_{index}",
            [obstacles[name] for name in entry["obstacles"]],
            provenance,
        )
    write_dataset_file(
        TARGET,
        "dynabarn60",
        worlds,
        {"credit": PAPER, "data": content["source"], "licence": LICENCE},
    )


def _obstacle(name: str, profile: dict[str, Any]) -> MovingObstacle:
    motion = Motion("gazebo", profile["period_s"], tuple(map(tuple, profile["keys"])))
    return MovingObstacle(
        name, radius_m=profile["radius_m"], height_m=profile["height_m"], motion=motion
    )


if __name__ == "__main__":
    main()
