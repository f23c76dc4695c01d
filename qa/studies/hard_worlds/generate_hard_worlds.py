"""Write a data set of hard worlds, with paths proven for a robot's turned footprint.

    python qa/studies/hard_worlds/generate_hard_worlds.py out/mine.npz --seed 7
    python qa/studies/hard_worlds/generate_hard_worlds.py out/burger.npz --kind doors \
        --set spare_cells=0 --robot turtlebot3_burger

Worlds are numbered from wide to narrow, as those of `barn worlds generate`. With the
default seed and robot the file is the shipped `barn_hard`.
"""

from collections.abc import Sequence
from pathlib import Path

import click
import yaml
from hard_worlds import KINDS, HardParameters, generate_hard_worlds

from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.datasets.generate import NARROWNESS, narrowness, write_ordered
from barn_worlds.formats.dataset_file import WorldOrder
from barn_worlds.robots.files import load_robot, name_unless_standard
from barn_worlds.worlds.course import cell_size_m


def write_hard_worlds(
    target: Path,
    kinds: Sequence[str] = KINDS,
    worlds_per_kind: int = 25,
    seed: int = 32,
    robot_name: str = "jackal",
    changes: Sequence[str] = (),
) -> int:
    """Write hard worlds as a data set file and return how many there are.

    Args:
        target: File to write, .npz.
        kinds: Some of `KINDS`.
        worlds_per_kind: Number of worlds of each kind.
        seed: Seed of all randomness.
        robot_name: Name or file of the robot; cells have the size that suits it.
        changes: Changes to `HardParameters` as KEY=VALUE.

    Raises:
        BarnError: If the file has another ending or exists, the robot or a parameter is
            not known, or no path is found.
    """
    if target.suffix != ".npz":
        raise ConfigError(f"{target}: must end in .npz")
    if target.exists():
        raise ConfigError(f"{target}: exists already")
    robot = load_robot(robot_name)
    values: dict[str, object] = {"resolution_m": cell_size_m(robot)}
    for change in changes:
        key, _, text = change.partition("=")
        values[key] = yaml.safe_load(text)
    parameters = replace_dotted(HardParameters(), values, "parameters of hard worlds")

    worlds = generate_hard_worlds(
        parameters, kinds, worlds_per_kind, seed, robot, target.stem
    )
    order = WorldOrder(NARROWNESS, tuple(map(narrowness, worlds)))
    description = {"seed": seed, "robot": name_unless_standard(robot.chassis)}
    write_ordered(target, target.stem, worlds, order, description)
    return len(worlds)


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS))
@click.option("--per-kind", default=25, show_default=True, help="Worlds of each kind.")
@click.option("--seed", default=32, show_default=True)
@click.option("--robot", default="jackal", show_default=True, help="Name or file.")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE")
def main(
    target: Path,
    kinds: Sequence[str],
    per_kind: int,
    seed: int,
    robot: str,
    changes: Sequence[str],
) -> None:
    """Write hard worlds of some kinds (default: all) to TARGET, a new .npz file."""
    try:
        count = write_hard_worlds(
            target, kinds or KINDS, per_kind, seed, robot, changes
        )
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"{count} worlds in {target}")


if __name__ == "__main__":
    main()
