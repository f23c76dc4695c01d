"""The picture of a finished trial: the world, the robot's trail coloured by its speed, contacts, start and goal."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from barn_eval.bags.messages import MOVED_M, trial_scene
from barn_eval.trials.result import TrialResult
from barn_eval.trials.trial import FinishedTrial
from barn_worlds.base.types import NANOSECONDS
from barn_worlds.drawing.files import write_png
from barn_worlds.drawing.palette import CONTACT
from barn_worlds.drawing.scene import discs, draw_contacts, draw_outlines, draw_scene, draw_trail, scale_speeds

_DOTS_PER_INCH = 110
_OUTLINE_PERIOD_NS = 2 * NANOSECONDS


def draw_trial(finished: FinishedTrial, path: Path) -> None:
    """Write the picture of a trial as PNG; WorldError if the file cannot be written."""
    scene, trajectory = trial_scene(finished.spec), finished.trajectory
    figure = Figure(figsize=(6.0, 9.0))
    axes = figure.add_subplot()
    draw_scene(axes, scene)
    at_end_m = scene.cylinders_m if finished.cylinders_m is None else finished.cylinders_m
    moved = np.hypot(*(at_end_m - scene.cylinders_m).T) > MOVED_M
    if moved.any():
        discs(axes, at_end_m[moved], scene.radius_m, facecolor="none", edgecolor=CONTACT, linewidth=0.8)
        axes.scatter([], [], facecolor="none", edgecolor=CONTACT, label="pushed obstacle, at the end")
    poses, stamps = trajectory.truth, trajectory.stamps_ns
    if len(stamps):
        scale_speeds(axes, [draw_trail(axes, poses[:, :2], trajectory.velocity[:, 0])])
        shown = np.searchsorted(stamps, np.arange(int(stamps[0]), int(stamps[-1]), _OUTLINE_PERIOD_NS))
        corners_m = np.array(finished.spec.simulator.chassis.hull_m)
        draw_outlines(axes, poses[np.append(shown, -1)], corners_m, linewidth=0.5, zorder=2)
        if trajectory.contact.any():
            draw_contacts(axes, poses[trajectory.contact, :2], "contact")
    x_min, y_min, x_max, y_max = finished.spec.world.bounds_m
    seen = np.vstack([[x_min, y_min], [x_max, y_max], scene.ends_m(), poses[:, :2]])
    low, high = seen.min(axis=0) - 0.4, seen.max(axis=0) + 0.4
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(_title(finished.result), fontsize=10, loc="left", parse_math=False)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 0.08), fontsize=8, framealpha=0.9)
    write_png(figure, path, _DOTS_PER_INCH)


def _title(result: TrialResult) -> str:
    scores = result.scores
    seconds = "the clock never started" if scores.traversal_time_s is None else f"{scores.traversal_time_s:.2f} s"
    named = f"{result.planner}, world {result.world}, {result.protocol}, repetition {result.repetition}"
    figures = f"{scores.normalised_time_s_per_m:.2f} s/m, challenge metric {scores.challenge:.3f}"
    return f"{named}\n{result.outcome.value}: {seconds}, {figures}"
