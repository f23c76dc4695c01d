"""Names and colours of planners, the same wherever they are written or drawn."""

from collections.abc import Sequence

from barn_worlds.drawing.palette import PLANNERS

_SPELLINGS = {
    "dwa": "DWA",
    "eband": "E-Band",
    "mppi": "MPPI",
    "gap": "gap",
    "policy": "policy",
}
_COLOURS = dict(zip(_SPELLINGS, PLANNERS, strict=False))
_OTHERS = (*PLANNERS[len(_SPELLINGS) :], *PLANNERS[: len(_SPELLINGS)])


def spelling(planner: str) -> str:
    """Return the name of a planner as readers know it: the suite's own in their usual spelling, others as they are."""
    return _SPELLINGS.get(planner, planner)


def colours(planners: Sequence[str]) -> list[str]:
    """Return the colour of each planner of a figure.

    The suite's own planners have theirs wherever they are; others, and a planner that is there again, take those that
    are left, in their order, a light one after a dark one and the other way round. After seven all colours come again.
    """
    own = [
        _COLOURS.get(name) if name not in planners[:place] else None
        for place, name in enumerate(planners)
    ]
    chosen: list[str] = []
    free: list[str] = []
    for known in own:
        free = (
            free
            or [one for one in _OTHERS if one not in own and one not in chosen]
            or list(_OTHERS)
        )
        colour = known or ""
        if not known:
            other = [one for one in free if chosen and _dark(one) != _dark(chosen[-1])]
            colour = (other or free)[0]
            free.remove(colour)
        chosen.append(colour)
    return chosen


def _dark(colour: str) -> bool:
    return PLANNERS.index(colour) % 2 == 0
