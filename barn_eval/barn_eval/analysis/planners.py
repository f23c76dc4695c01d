"""Names and colours of planners, the same wherever they are written or drawn."""

from collections.abc import Sequence

from barn_worlds.drawing.palette import PLANNERS

_SPELLINGS = {"dwa": "DWA", "eband": "E-Band", "mppi": "MPPI", "gap": "gap", "policy": "policy"}
_COLOURS = dict(zip(_SPELLINGS, PLANNERS, strict=False))
_OTHERS = (*PLANNERS[len(_SPELLINGS) :], *PLANNERS[: len(_SPELLINGS)])


def spelling(planner: str) -> str:
    """Return the name of a planner as readers know it: the suite's own in their usual spelling, others as they are."""
    return _SPELLINGS.get(planner, planner)


def colours(planners: Sequence[str]) -> list[str]:
    """Return the colour of each planner of a figure.

    The suite's own planners have theirs wherever they are; others, and a planner that is there again, take those that
    are left, in their order. After seven all colours come again.
    """
    chosen: dict[int, str] = {}
    for place, planner in enumerate(planners):
        if planner in _COLOURS and planner not in planners[:place]:
            chosen[place] = _COLOURS[planner]
    free = [colour for colour in _OTHERS if colour not in chosen.values()] or _OTHERS
    rest = (place for place in range(len(planners)) if place not in chosen)
    chosen |= {place: free[count % len(free)] for count, place in enumerate(rest)}
    return [chosen[place] for place in range(len(planners))]
