"""Names and colors of planners, the same wherever they are written or drawn."""

from collections.abc import Sequence

from barn_worlds.drawing.palette import PLANNERS

_SPELLINGS = {
    "dwa": "DWA",
    "eband": "E-Band",
    "mppi": "MPPI",
    "gap": "gap",
    "policy": "policy",
}
_SUITE_COLORS = dict(zip(_SPELLINGS, PLANNERS, strict=False))
# Colors for other planners, in the order in which they are assigned.
_FREE_COLORS = (*PLANNERS[len(_SPELLINGS) :], *PLANNERS[: len(_SPELLINGS)])


def spelling(planner: str) -> str:
    """Return a suite planner's display name, "DWA" for "dwa"; others unchanged."""
    return _SPELLINGS.get(planner, planner)


def assign_colors(planners: Sequence[str]) -> list[str]:
    """Return a color per planner: the suite's have fixed ones, others take free ones.

    The suite's planners always have the same colors. Other planners, and repeated ones,
    take the remaining colors in order, alternating light and dark. After seven planners,
    colors repeat.
    """
    fixed_colors: list[str | None] = []
    for position, name in enumerate(planners):
        is_first = name not in planners[:position]
        fixed_colors.append(_SUITE_COLORS.get(name) if is_first else None)

    colors: list[str] = []
    free: list[str] = []
    for fixed in fixed_colors:
        if not free:
            taken = {*fixed_colors, *colors}
            free = [color for color in _FREE_COLORS if color not in taken]
        if not free:
            free = list(_FREE_COLORS)

        if fixed:
            colors.append(fixed)
            continue
        # Neighbors differ in lightness, so that they look different in gray print.
        color = free[0]
        if colors:
            contrasting = [c for c in free if _is_dark(c) != _is_dark(colors[-1])]
            color = (contrasting or free)[0]
        free.remove(color)
        colors.append(color)

    return colors


def _is_dark(color: str) -> bool:
    """Tell whether a palette color is a dark one; they alternate with light ones."""
    return PLANNERS.index(color) % 2 == 0
