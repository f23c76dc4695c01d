"""Planners that try to change their score."""

from functools import partial

from fault_cases.kit import Lab, add, ending, hold
from fault_cases.planners import FOREIGN, by_command, judged, ros

FAMILY = "meddling"


def _caught(lab: Lab, kind: str, words: str) -> str:
    lab.barn(*ros(lab, *by_command(FOREIGN, lab.folder / "starts", kind)))
    said = judged(lab, "interference", words)
    scores = lab.row()["scores"]
    hold(not scores["success"] and scores["challenge"] == 0.0, scores)
    return said


def _named(lab: Lab, ground_truth: str, heard: bool) -> str:
    words = by_command(FOREIGN, lab.folder / "starts", "curious")
    lab.barn(*ros(lab, *words, "--ros", f"ground_truth={ground_truth}"))
    row = lab.row()
    hold("/foreign subscribed to /ground_truth/odom" in row["remarks"], row["remarks"])
    hold((lab.folder / "starts.heard").exists() is heard, "heard" if not heard else "not heard")
    return f"{ending(row)}; {row['remarks']}"


_MUST = "The trial ends as interference, without a score, and names who did what."
for _kind, _done, _words in (
    ("poses", "The planner publishes poses at the goal on /odom and /ground_truth/odom.", "publishes /odom"),
    ("older_stamps", "The planner publishes /clock with time 0.", "publishes /clock"),
    ("no_contact", "The planner publishes on /collision that there is no contact.", "publishes /collision"),
    ("score", "The planner publishes /score.", "publishes /score"),
    ("twin", "The planner's node has the simulator's name, and publishes /scan.", "named /simulator"),
    ("parameters", "The planner sets the start pose of the simulator.", "set start_y_m of simulator"),
    ("reset", "The planner calls the simulator's reset.", "called simulator/reset"),
    ("pause", "The planner calls the simulator's pause.", "called simulator/pause"),
):
    add(FAMILY, _kind.replace("_", "-"), _done, _MUST, partial(_caught, kind=_kind, words=_words))

add(
    FAMILY,
    "reads-the-truth",
    "The planner subscribes to /ground_truth/odom.",
    "It hears nothing, and the row names it.",
    partial(_named, ground_truth="false", heard=False),
)
add(
    FAMILY,
    "reads-the-truth-asked-for",
    "The planner subscribes to /ground_truth/odom in a run with --ros ground_truth=true.",
    "It hears the truth, and the row names it.",
    partial(_named, ground_truth="true", heard=True),
)
add(
    FAMILY,
    "broken-bytes",
    "The planner publishes bytes on /cmd_vel that are no command.",
    "The trial ends as invalid_command, by the planner's fault.",
    lambda lab: (
        lab.barn(*ros(lab, *by_command(FOREIGN, lab.folder / "starts", "broken_command"))),
        judged(lab, "invalid_command", "not finite"),
    )[1],
)
