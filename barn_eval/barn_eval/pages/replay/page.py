"""The page of a trial, or of several on one clock."""

from barn_eval.analysis.planners import colours
from barn_eval.bags.recorded import MAP, Recorded
from barn_eval.pages.replay.facts import facts, labels, planner_of, subtitle, world_key
from barn_eval.pages.replay.payload import payload
from barn_eval.pages.template import render

# What the page says of the time shown, by the ids of its places.
_READOUTS = (
    ("pose", "robot"),
    ("driven", "driven"),
    ("commanded", "commanded"),
    ("clearance", "clearance"),
    ("progress", "along the path"),
    ("contact", "contact"),
    ("score", "challenge metric so far"),
)


def replay_page(*found: Recorded) -> str:
    """Return the page of one trial or several, whatever their bags hold as text being text in it."""
    named = labels(found)
    shades = colours([planner_of(recorded) for recorded in found])
    known = len(found) > 1 or planner_of(found[0])
    trials = [
        {"label": label, "colour": shade if known else "", "subtitle": subtitle(recorded), "notes": recorded.notes}
        for label, shade, recorded in zip(named, shades, found, strict=True)
    ]
    drawn = [
        payload(recorded) | {"label": label, "colour": shade}
        for label, shade, recorded in zip(named, shades, found, strict=True)
    ]
    rows = [dict(facts(recorded)) for recorded in found]
    frames = {(recorded.frame, "true pose" if recorded.frame == MAP else "odometry"): None for recorded in found}
    return render(
        "replay.html",
        title=" and ".join(dict.fromkeys(recorded.name for recorded in found)),
        trials=trials,
        readouts=_READOUTS,
        facts=[
            (name, [row.get(name, "") for row in rows]) for name in dict.fromkeys(key for row in rows for key in row)
        ],
        frames=list(frames),
        along_path=all(one["along_path"] for one in drawn),
        moving=any(recorded.moving is not None for recorded in found),
        same_world=len({world_key(recorded) for recorded in found}) == 1 and found[0].scene is not None,
        data={"trials": drawn},
    )
