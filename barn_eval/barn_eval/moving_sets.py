"""Worlds in which obstacles move, from Python: generated ones, and figures of how they move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from barn_eval.world_sets import new_npz, worlds
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError

if TYPE_CHECKING:
    from barn_metrics.motion import MotionStatistics
    from barn_worlds.worlds.world import World


def generate_moving(
    out: str | Path | None = None,
    classes: Sequence[str] = ("easy", "medium", "hard"),
    *,
    per_class: int = 20,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    source: str | Path | None = None,
    select: str = "all",
    crossing: bool = False,
    obstacles: int | None = None,
) -> dict[int, World]:
    """Generate worlds in which obstacles move, and return them by number, one class after the other.

    out: file (.npz) to write them to; it must not be there. Without `source` they are arenas as in DynaBARN, per_class
    of each class. parameters: changes to the classes, by name (see `barn_worlds.moving.generate.MotionParameters`).

    source: data set whose worlds, or those that `select` names, get obstacles of the one class given, and keep their
    numbers. crossing: these go to and fro across the path. obstacles: how many; None draws from the class.
    """
    from barn_worlds.formats.own import write_own  # noqa: PLC0415
    from barn_worlds.moving.generate import (  # noqa: PLC0415
        class_named,
        generate_arenas,
        with_crossings,
        with_motion,
    )

    target = None if out is None else new_npz(out)
    chosen = [replace_dotted(class_named(name), dict(parameters or {}), "parameters of a class") for name in classes]
    if source is None:
        if crossing or obstacles is not None:
            raise ConfigError("crossings and a number of obstacles are for the worlds of a data set; name one")
        made = dict(enumerate(world for one in chosen for world in generate_arenas(one, per_class, seed)))
    elif len(chosen) != 1:
        raise ConfigError(f"one class of motion must be named for the worlds of {source}, got {len(chosen)}")
    else:
        add = with_crossings if crossing else with_motion
        still = worlds(source, select)
        made = {index: add(world, chosen[0], seed + index, obstacles) for index, world in still.items()}
    if target is not None:
        write_own(target, target.stem, made, {"seed": seed})
    return made


def motion_table(source: str | Path, select: str = "all") -> list[tuple[str, int, MotionStatistics]]:
    """Return, for each class of a data set's worlds, its name, the number of worlds and the means of their motion."""
    from barn_metrics.motion import mean_statistics  # noqa: PLC0415 (compiled kernels)

    by_class: dict[str, list[World]] = {}
    for world in worlds(source, select).values():
        given = world.provenance.parameters
        name = given.get("motion", given).get("difficulty", "all")
        by_class.setdefault(str(name), []).append(world)
    return [(name, len(some), mean_statistics(some)) for name, some in by_class.items()]
