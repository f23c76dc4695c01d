"""Pictures of worlds."""

from collections.abc import Mapping
from pathlib import Path

from barn_eval.pages.figures import Plot
from barn_metrics.world_figure import world_figure as metrics_figure
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.drawing.files import write_png
from barn_worlds.drawing.worlds import sheet_figure, world_figure, write_animation
from barn_worlds.worlds.world import World


def draw(shown: World | Mapping[int, World], *, metrics: bool = False) -> Plot:
    """Return a figure of one world, or of many on a sheet.

    Args:
        shown: The world, or worlds by number.
        metrics: Whether a map of each difficulty metric is drawn as well, of one world.

    Raises:
        BarnError: Metrics are asked for of several worlds, or of one that has none.
    """
    if isinstance(shown, Mapping):
        if metrics:
            raise ConfigError("metrics are drawn of one world, not of several")
        return Plot(sheet_figure(shown), f"{len(shown)} worlds")
    return Plot(metrics_figure(shown) if metrics else world_figure(shown), shown.name)


def write_figure(shown: Mapping[int, World], target: str | Path) -> None:
    """Write a picture of worlds, on a sheet if they are several, or an animation of one that moves.

    Args:
        shown: The worlds by number.
        target: File, .png or .gif.

    Raises:
        BarnError: An animation is asked for of several worlds or of one that does not move.
    """
    if Path(target).suffix == ".gif":
        if len(shown) != 1:
            raise WorldError(f"an animation shows one world, got {len(shown)}; select one with --worlds")
        write_animation(next(iter(shown.values())), Path(target))
    else:
        write_png(world_figure(next(iter(shown.values()))) if len(shown) == 1 else sheet_figure(shown), Path(target))
