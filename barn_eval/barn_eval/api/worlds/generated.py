"""Worlds that are made: static ones, and ones in which obstacles move."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from barn_eval.api.worlds.sets import load, new_npz, require_new, write_layout
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError
from barn_worlds.datasets import generate as maker
from barn_worlds.datasets.generate_motion import (
    add_crossings,
    add_motion,
    generate_arenas,
    motion_class,
)
from barn_worlds.formats.own import write_own
from barn_worlds.robots.files import load_robot, other_name
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

Progress = Callable[[int, int], None]


def generate(
    out: str | Path | None = None,
    *,
    per_set: int = 25,
    seed: int = 2020,
    parameters: Mapping[str, object] | None = None,
    robot: str | Path = "jackal",
    keep: int = 0,
    progress: Progress | None = None,
) -> dict[int, World]:
    """Generate worlds and return them by number, the easiest (widest) first.

    For instance, worlds of one's own, and a planner in them:

        worlds = barn.worlds.generate(per_set=3, parameters={"initial_fill": 0.25}, seed=1)
        barn.run(worlds, planners="gap")

    Args:
        out: File (.npz) or folder in the original layout to write them to, which must not be there.
        per_set: Worlds per parameter set.
        seed: All randomness comes from it.
        parameters: One set of your own, by name (see `barn_worlds.datasets.generate.WorldParameters`); without, the
            twelve of the paper's Table I.
        robot: What paths are planned for; cells are in its size, 5 x 5 of them to a robot, unless parameters say how
            large they are.
        keep: How many to keep, evenly spread over the order from wide to narrow; 0 for all.
        progress: Called with the numbers of worlds made and of all.

    Raises:
        BarnError: A parameter is not allowed, or the file cannot be written.
    """
    target = Path(out) if out is not None else None
    if target is not None:
        require_new(target)
    driven = load_robot(robot)
    named = other_name(driven.chassis)
    file = target if target is not None and target.suffix == ".npz" else None
    name, sets = (
        target.stem if target else "generated",
        _sets(parameters or {}, driven),
    )
    asked = maker.DatasetParameters(
        name, seed, per_set, keep=keep, robot=named, sets=sets
    )
    if file:
        maker.write_dataset(file, asked, progress=progress)
        return load(file)
    worlds, order = maker.generate_ranked_dataset(asked, progress=progress)
    numbered = maker.renumber(worlds, order)
    if target is not None:
        write_layout(target, numbered)
    return numbered


def _sets(
    changes: Mapping[str, object], robot: Robot
) -> tuple[maker.WorldParameters, ...]:
    """Return sets of parameters with cells in the size of a robot, unless changes say otherwise."""
    sets = (
        (replace_dotted(maker.WorldParameters(), changes, "world parameters"),)
        if changes
        else maker.TABLE_I
    )
    sized: dict[str, float] = {}
    if not {"resolution_m", "footprint_cells"} & set(changes):
        sized["resolution_m"] = maker.cell_size_m(robot)
    if "footprint_cells" not in changes:
        sized["footprint_cells"] = robot.footprint_cells(
            sized.get("resolution_m", sets[0].resolution_m)
        )
    return tuple(replace_dotted(one, sized, "world parameters") for one in sets)


def generate_moving(
    out: str | Path | None = None,
    classes: Sequence[str] = ("easy", "medium", "hard"),
    *,
    per_class: int = 20,
    seed: int = 0,
    parameters: Mapping[str, object] | None = None,
    source: str | Path | None = None,
    select: str = "all",
    crossing: bool = False,
    obstacles: int | None = None,
) -> dict[int, World]:
    """Generate worlds in which obstacles move, and return them by number, one class after the other.

    Args:
        out: File (.npz) to write them to, which must not be there.
        classes: Classes of motion. Without `source` they are arenas as in DynaBARN.
        per_class: Arenas of each class.
        seed: All randomness comes from it.
        parameters: Changes to the classes, by name (see `barn_worlds.datasets.generate_motion.MotionParameters`).
        source: Data set whose worlds get obstacles of the one class given, and keep their numbers.
        select: Which of these worlds.
        crossing: Whether these obstacles go to and fro across the path.
        obstacles: How many a world gets; None draws from the class.

    Raises:
        BarnError: A class or parameter is not known, or the file cannot be written.
    """
    target = None if out is None else new_npz(out)
    chosen = [
        replace_dotted(
            motion_class(name), dict(parameters or {}), "parameters of a class"
        )
        for name in classes
    ]
    if source is None:
        if crossing or obstacles is not None:
            raise ConfigError(
                "crossings and a number of obstacles are for the worlds of a data set; name one"
            )
        made = dict(
            enumerate(
                world
                for one in chosen
                for world in generate_arenas(one, per_class, seed)
            )
        )
    elif len(chosen) != 1:
        raise ConfigError(
            f"one class of motion must be named for the worlds of {source}, got {len(chosen)}"
        )
    else:
        add = add_crossings if crossing else add_motion
        still = load(source, select)
        made = {
            index: add(world, chosen[0], seed + index, obstacles)
            for index, world in still.items()
        }
    if target is not None:
        write_own(target, target.stem, made, {"seed": seed})
    return made
