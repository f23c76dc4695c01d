"""The picture of a finished trial: the world, the robot's trail coloured by its speed, contacts, start and goal."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from barn_eval.bags.true_scene import MOVED_M
from barn_eval.trials.result import TrialResult
from barn_eval.trials.trajectory import Floats, Trajectory
from barn_eval.trials.trial import FinishedTrial
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import replacing
from barn_worlds.base.types import NANOSECONDS, Pose2D
from barn_worlds.worlds.world import World

_DOTS_PER_INCH = 110
_OUTLINE_PERIOD_NS = 2 * NANOSECONDS
# Colours that differ in lightness as well, after Okabe and Ito.
_START, _GOAL, _CONTACT, _OBSTACLE, _PATH = "#0072B2", "#009E73", "#D55E00", "#4d4d4d", "#b0b0b0"


def draw_trial(finished: FinishedTrial, path: Path) -> None:
    """Write the picture of a trial as PNG; ConfigError if the file cannot be written."""
    spec = finished.spec
    figure = Figure(figsize=(6.0, 9.0))
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _draw_world(axes, spec.world, finished.cylinders_m)
    _draw_endpoint(axes, spec.course.start, "start", _START, None)
    _draw_endpoint(axes, spec.course.goal, "goal", _GOAL, spec.rules.goal_distance_m)
    if len(finished.trajectory.stamps_ns):
        _draw_trail(figure, axes, finished.trajectory, np.array(spec.simulator.chassis.hull_m))
    _frame(axes, finished)
    axes.set_title(_title(finished.result), fontsize=10, loc="left")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 0.08), fontsize=8, framealpha=0.9)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as partial:
            figure.savefig(partial, dpi=_DOTS_PER_INCH, format="png", bbox_inches="tight", metadata={"Software": None})
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None


def _draw_world(axes: Axes, world: World, at_end_m: Floats | None) -> None:
    axes.add_collection(_discs(axes, world.cylinders_m, world.cylinder_radius_m, _OBSTACLE))
    moved = np.zeros(0, np.bool_) if at_end_m is None else np.hypot(*(at_end_m - world.cylinders_m).T) > MOVED_M
    if at_end_m is not None and moved.any():
        pushed = _discs(axes, at_end_m[moved], world.cylinder_radius_m, "none")
        pushed.set(edgecolor=_CONTACT, linewidth=0.8)
        axes.add_collection(pushed)
        axes.scatter([], [], facecolor="none", edgecolor=_CONTACT, label="pushed obstacle, at the end")
    route = world.path_m()
    axes.plot(route[:, 0], route[:, 1], color=_PATH, linewidth=1.2, linestyle="--", label="path of the world")


def _discs(axes: Axes, centres: Floats, radius: float, colour: str) -> EllipseCollection:
    size, angle = np.full(len(centres), 2.0 * radius), np.zeros(len(centres))
    return EllipseCollection(
        size, size, angle, units="x", offsets=centres, offset_transform=axes.transData, facecolor=colour
    )


def _draw_endpoint(axes: Axes, pose: Pose2D, name: str, colour: str, radius: float | None) -> None:
    axes.plot(
        pose.x, pose.y, marker="o" if name == "start" else "*", color=colour, markersize=9, linestyle="", label=name
    )
    if radius is not None:
        axes.add_patch(Circle((pose.x, pose.y), radius, fill=False, color=colour, linewidth=1.0, linestyle=":"))


def _draw_trail(figure: Figure, axes: Axes, trajectory: Trajectory, corners: Floats) -> None:
    positions = trajectory.truth[:, :2]
    segments = np.stack([positions[:-1], positions[1:]], axis=1)
    speed = trajectory.velocity[1:, 0]
    top = max(0.5, float(speed.max(initial=0.0)))
    trail = LineCollection(list(segments), cmap="viridis", linewidth=2.2, zorder=3)
    trail.set_array(np.abs(speed))
    trail.set_clim(0.0, top)
    axes.add_collection(trail)
    figure.colorbar(trail, ax=axes, label="speed [m/s]", fraction=0.035, pad=0.02)
    stamps = trajectory.stamps_ns
    shown = np.searchsorted(stamps, np.arange(int(stamps[0]), int(stamps[-1]), _OUTLINE_PERIOD_NS))
    outlines = [Pose2D(*pose).transform(corners) for pose in trajectory.truth[np.append(shown, -1)].tolist()]
    axes.add_collection(PolyCollection(outlines, facecolor="none", edgecolor="black", linewidth=0.5, zorder=2))
    touching = positions[trajectory.contact]
    if len(touching):
        axes.plot(*touching.T, marker="x", color=_CONTACT, linestyle="", markersize=7, zorder=4, label="contact")


def _frame(axes: Axes, finished: FinishedTrial) -> None:
    x_min, y_min, x_max, y_max = finished.spec.world.bounds_m
    course = finished.spec.course
    ends = [[course.start.x, course.start.y], [course.goal.x, course.goal.y]]
    points = np.vstack([[x_min, y_min], [x_max, y_max], ends, finished.trajectory.truth[:, :2]])
    low, high = points.min(axis=0) - 0.4, points.max(axis=0) + 0.4
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")


def _title(result: TrialResult) -> str:
    scores = result.scores
    seconds = "the clock never started" if scores.traversal_time_s is None else f"{scores.traversal_time_s:.2f} s"
    named = f"{result.planner}, world {result.world}, {result.protocol}, repetition {result.repetition}"
    figures = f"{scores.normalised_time_s_per_m:.2f} s/m, challenge metric {scores.challenge:.3f}"
    return _plain(f"{named}\n{result.outcome.value}: {seconds}, {figures}")


def _plain(text: str) -> str:
    """Keep names with dollar signs from being read as formulas."""
    return text.replace("$", r"\$")
