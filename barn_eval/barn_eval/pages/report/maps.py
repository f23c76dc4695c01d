"""Draw maps of worlds with the trajectories of trials."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from barn_eval.analysis.difficulty import WorldOrder, means_by_world
from barn_eval.analysis.entries import Entry, read_entries
from barn_eval.analysis.measures import ranking_measure
from barn_eval.analysis.text_table import count_noun
from barn_eval.pages.figures import add_tips, new_figure, plain_text
from barn_eval.pages.report.charts import ChartData, MakePanels, Panels, chart
from barn_eval.pages.report.trials import (
    DrivenTrial,
    make_scene,
    make_scene_if_known,
    read_trials,
)
from barn_eval.results.row_table import column
from barn_eval.results.tracks import CHANNELS
from barn_eval.trials.result import Outcome
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.drawing import scene as drawing
from barn_worlds.drawing.palette import CONTACT, FAINT, GOAL, INK, MOVER
from barn_worlds.geometry.bodies import moving_bodies
from barn_worlds.worlds.scene import TrialScene
from barn_worlds.worlds.world import World

OVERLAY_COLORS = ("planner", "speed")
_SPEED = CHANNELS.index("speed")
_MOVER_FILL = MOVER + "55"

# The figure of the hardest worlds, the width of a map in it, and room for its labels.
_MAPS_WIDTH_IN = 16.0
_MAPS_PER_ROW = 4
_MAP_IN = 3.0
_MAP_LABELS_IN = 1.0
_LEGEND_IN = 2.5
# A map has the first trails of each planner: more would hide each other.
_MAX_TRAILS = 12
# The figure of an overlay, and room beside it for labels and legend.
_OVERLAY_HEIGHT_IN = 8.0
_OVERLAY_SIDE_IN = 3.4
# Arenas are as wide as they are high and need this much more.
_ARENA_SIDE_IN = 1.2

_MOTION_STEP_S = 0.1
_MAX_MOTION_S = 200.0
_MIN_ARROW_M = 0.3


def order_by_contrast(entries: Sequence[Entry], order: WorldOrder) -> list[int]:
    """Return world numbers by how much planners' means differ in them, the most first.

    The means are of the ranking measure; of equal worlds the harder comes first.
    """
    measure = ranking_measure(entries[0].results)
    groups = [means_by_world(entry.results, measure) for entry in entries]

    def contrast(world: int) -> float:
        """Return the range of the planners' means in a world, 0 if one is NaN."""
        means = [group[world] for group in groups if world in group]
        return float(np.nan_to_num(np.ptp(means)))

    # Of equal worlds the first stays first.
    hardest_first = order.worlds[::-1]
    return sorted(hardest_first, key=contrast, reverse=True)


def select_worlds(
    numbers: Iterable[int], trials: Iterable[DrivenTrial], count: int
) -> dict[int, tuple[World, list[DrivenTrial]]]:
    """Return the first `count` available worlds with all their trials, by number.

    Args:
        numbers: Numbers of worlds, in order of preference.
        trials: Trials in any worlds. A number that means different worlds in different
            trials is left out, and so is a world that cannot be read.
        count: Number of worlds at most.
    """
    groups: dict[int, list[DrivenTrial]] = {}
    for trial in trials:
        groups.setdefault(trial.result.world, []).append(trial)
    selection: dict[int, tuple[World, list[DrivenTrial]]] = {}
    for number in numbers:
        if len(selection) == count:
            break
        inside = groups.get(number, [])
        checksums = {trial.result.world_checksum for trial in inside}
        if len(checksums) == 1 and isinstance(inside[0].world, World):
            selection[number] = (inside[0].world, inside)
    return selection


@chart("The trails of all planners in the world where they differ most")
def _trails(data: ChartData, make_panels: MakePanels) -> Sequence[Line2D]:
    """Draw a map of one world with tracks of all planners; return legend entries."""
    numbers = order_by_contrast(data.entries, data.order)
    tracked = [trial for trial in data.trials if trial.has_track]
    layout = Panels(0.0, width_in=_MAP_IN + _LEGEND_IN, is_legend_beside=True)
    selection = select_worlds(numbers, tracked, 1)
    return _draw_maps(data, selection, make_panels, layout)


@chart("The hardest worlds with trajectories of all planners")
def _hardest(data: ChartData, make_panels: MakePanels) -> Sequence[Line2D]:
    """Draw a map of each hardest world with tracks in it; return legend entries."""
    layout = Panels(0.0, _MAPS_PER_ROW, width_in=_MAPS_WIDTH_IN)
    selection = select_worlds(reversed(data.order.worlds), data.trials, data.hardest)
    return _draw_maps(data, selection, make_panels, layout)


def _draw_maps(
    data: ChartData,
    worlds: Mapping[int, tuple[World, Sequence[DrivenTrial]]],
    make_panels: MakePanels,
    layout: Panels,
) -> Sequence[Line2D]:
    """Draw a map of each world with its tracks; return legend entries, () if none.

    `layout` gets the rows and the height that the maps need.
    """
    if not worlds:
        return ()
    # Maps are as wide as there is room.
    corners = []
    ratios = []
    for world, trials in worlds.values():
        scene = make_scene_if_known(trials[0].entry.source, world)
        low, high = _map_corners(scene, world, trials)
        width, height = high - low
        corners.append((low, high))
        ratios.append(height / width)
    rows = -(-len(worlds) // layout.columns)
    height_in = (_MAP_IN * max(ratios) + _MAP_LABELS_IN) * rows
    panels = make_panels(layout._replace(height_in=height_in, rows=rows))
    for axes in panels[len(worlds) :]:
        axes.set_axis_off()
    maps = zip(panels, corners, worlds.items(), strict=False)
    for axes, (low, high), (number, (world, trials)) in maps:
        _draw_map(data, axes, world, trials)
        _show_area(axes, low, high)
        axes.grid(visible=True)
        axes.set_axisbelow(True)
        difficulty = data.order.mean_s_per_m[data.order.worlds.index(number)]
        successes = sum(trial.result.scores.success for trial in trials)
        axes.set_title(
            f"world {number}: {difficulty:.2f} s/m\n"
            f"{successes} of {len(trials)} trials succeed"
        )

    handles = []
    for look, dashes in zip(data.looks, data.dashes, strict=True):
        handles.append(Line2D([], [], linewidth=2, linestyle=dashes, **look))
    handles += [
        _legend_mark(
            "end of a failed trial",
            color=INK,
            marker="x",
            markersize=8,
            markeredgewidth=2,
        ),
        Line2D([], [], color=FAINT, linestyle="--", label="shortest path"),
        *_end_handles(),
    ]
    if any(world.moving for world, _ in worlds.values()):
        handles += motion_handles()
    return handles


def _end_handles() -> list[Line2D]:
    """Return legend entries of start and goal."""
    start = Line2D([], [], label="start", **drawing.START_MARK)
    return [start, _legend_mark("goal", color=GOAL, marker="*", markersize=12)]


def _legend_mark(label: str, **look: Any) -> Line2D:
    """Return a legend entry that is a marker without a line."""
    return Line2D([], [], label=label, linestyle="", **look)


def _map_corners(
    scene: TrialScene, world: World, trials: Sequence[DrivenTrial]
) -> tuple[Floats, Floats]:
    """Return lower left and upper right corner of a world's map, each x, y [m]."""
    left, bottom, right, top = world.bounds_m
    heights = [scene.ends_m()[:, 1], *(trial.poses[:, 1] for trial in trials)]
    if world.corner_m is not None:
        # An arena is shown whole.
        heights.insert(0, np.array([bottom, top]))
    # Corridors are much longer than the course: what no robot came near is cut off.
    y = np.concatenate(heights)
    first, last = scene.path_m[[0, -1], 1]
    low = max(bottom, y.min(initial=first) - 0.8)
    # The circle around the goal is in view up to its top.
    high = max(top, last, y.max(initial=top)) + scene.goal_distance_m + 0.1
    trails = [trial.poses[:, :2] for trial in trials]
    return scene.view_m(np.array([left, low]), np.array([right, high]), *trails)


def _show_area(axes: Axes, low: Floats, high: Floats) -> None:
    """Limit axes to the corners `low` and `high` [m] in equal scale; label x and y."""
    axes.set(
        xlim=(low[0], high[0]),
        ylim=(low[1], high[1]),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
    )


def _draw_map(
    data: ChartData, axes: Axes, world: World, trials: Sequence[DrivenTrial]
) -> None:
    """Draw a world, its moving obstacles and up to 12 tracks of each planner."""
    scene = make_scene_if_known(trials[0].entry.source, world)
    drawing.draw_scene(axes, scene, faint=True)
    for number, entry in enumerate(data.entries):
        own_trials = [
            trial
            for trial in trials
            if trial.entry is entry and trial.track is not None
        ]
        own_trials = own_trials[:_MAX_TRAILS]
        draw_motion(axes, world, own_trials)
        style = {"color": entry.color, "linestyle": data.dashes[number]}
        marker = data.looks[number]["marker"]
        for trial in own_trials:
            trail = trial.poses[:, :2]
            result = trial.result
            outline_m = entry.source.outline.corners_m
            (line,) = axes.plot(*trail.T, linewidth=1.5, alpha=0.85, **style)
            text = (
                f"{entry.label}, trial {result.repetition + 1}: "
                f"{result.outcome.words} after {trial.end_s:.1f} s"
            )
            add_tips(line, [(text, number, result.world, "", result.repetition)])
            pose = trial.poses[-1:]
            drawing.draw_outlines(axes, pose, outline_m, entry.color, linewidth=1.0)
            draw_touched_mover(axes, world, trial)
            end: dict[str, Any] = {
                "marker": "x",
                "markersize": 9.0,
                "markeredgewidth": 2.4,
            }
            if result.scores.success:
                end = {"marker": marker, "markersize": 6.0}
            axes.plot(*trail[-1], color=entry.color, zorder=5, **end)


def draw_motion(axes: Axes, world: World, trials: Sequence[DrivenTrial]) -> None:
    """Draw the paths of moving obstacles during trials, with an arrow at each end.

    Args:
        axes: What is drawn onto.
        world: The world of the trials.
        trials: Those whose phases and lengths decide what paths are drawn.
    """
    if not world.moving:
        return
    # Trials that begin at the same phase share their paths, the longest counts.
    ends_s: dict[float, float] = {}
    for trial in trials:
        # Without a track nobody knows how long the trial lasted.
        if trial.result.motion is not None and trial.track is not None:
            phase_s = trial.result.motion.phase_s
            end_s = phase_s + trial.end_s
            ends_s[phase_s] = max(ends_s.get(phase_s, 0.0), end_s)

    for phase_s, end_s in ends_s.items():
        begin_s = max(phase_s, end_s - _MAX_MOTION_S)
        # A little beyond the end, so that arange does not leave it out.
        times_s = np.arange(begin_s, end_s + 1e-9, _MOTION_STEP_S)
        paths = drawing.motion_paths(world.tracks, times_s)
        drawing.draw_motion_paths(axes, paths, alpha=0.55, zorder=1.5)
        for path in paths:
            # On a closed or short path an arrow has no direction to show.
            if np.hypot(*(path[-1] - path[0])) > _MIN_ARROW_M:
                drawing.draw_arrow(
                    axes,
                    path[-1],
                    path[-1] - path[-2],
                    mutation_scale=8.0,
                    linewidth=0.6,
                    alpha=0.7,
                )


def draw_touched_mover(axes: Axes, world: World, trial: DrivenTrial) -> None:
    """Draw the moving obstacle that was hit, if any, where it was at the trial's end.

    Args:
        axes: What is drawn onto.
        world: The world of the trial.
        trial: Its result names the obstacle, its track the time of the end.
    """
    motion = trial.result.motion
    if motion is None or motion.touched not in world.tracks.names:
        return
    # The phase is the obstacles' own time at which the trial began.
    outlines = moving_bodies(world.tracks, motion.phase_s + trial.end_s).outlines()
    outline = outlines[world.tracks.names.index(motion.touched)]
    patch = PolyCollection(
        [outline],
        zorder=2.5,
        facecolor=_MOVER_FILL,
        edgecolor=trial.entry.color,
        linewidth=1.4,
    )
    axes.add_collection(patch)


def motion_handles() -> list[Line2D]:
    """Return legend entries for moving obstacles' paths and for the one hit."""
    return [
        Line2D([], [], color=MOVER, linewidth=1.0, alpha=0.7, label="moving obstacle"),
        _legend_mark(
            "obstacle that was hit",
            marker="o",
            markersize=9,
            markerfacecolor=_MOVER_FILL,
            markeredgecolor=MOVER,
        ),
    ]


def overlay(
    folders: Sequence[Path],
    world_number: int,
    *,
    by: str = "planner",
    planners: Sequence[str] = (),
    outcome: str = "",
) -> Figure:
    """Return a figure of one world with tracks of folders' trials; ConfigError if none.

    Args:
        folders: Results folders.
        world_number: Place of the world in its data set.
        by: What colors the trajectories, one of `OVERLAY_COLORS`.
        planners: Planners whose trials are drawn. By default all.
        outcome: Outcome that trials must have. By default any.

    Raises:
        ConfigError: There is no such trial, or worlds of that number differ.
    """
    if by not in OVERLAY_COLORS:
        raise ConfigError(
            f"by: must be one of {', '.join(OVERLAY_COLORS)}, got {by!r}"
            f"{suggest(by, OVERLAY_COLORS)}"
        )
    entries = read_entries(folders)
    trials, world = select_trials(entries, world_number, planners, outcome)
    scene = make_scene(trials[0].entry.source, world)
    low, high = _map_corners(scene, world, trials)
    width, height = high - low
    side_in = _OVERLAY_SIDE_IN
    if world.corner_m is not None:
        side_in += _ARENA_SIDE_IN
    # As wide as the map is at this height, so that no margin is left empty.
    map_in = (_OVERLAY_HEIGHT_IN - 1.0) * width / height
    figure = new_figure(_OVERLAY_HEIGHT_IN, side_in + map_in)
    axes = figure.add_subplot()
    drawing.draw_scene(axes, scene)
    draw_motion(axes, world, trials)
    trails = [_draw_trial(axes, world, trial, by) for trial in trials]
    if by == "speed":
        # One scale for all trials, else their colors could not be compared.
        drawing.scale_speeds(axes, trails)
    _show_area(axes, low, high)
    axes.set_title(f"world {world_number}: {count_noun(len(trials), 'trial')}")

    handles = _overlay_handles(trials, by)
    if world.moving:
        handles += motion_handles()
    figure.legend(handles=handles, loc="outside right upper")
    return figure


def select_trials(
    entries: Sequence[Entry], world: int, planners: Sequence[str], outcome: str
) -> tuple[list[DrivenTrial], World]:
    """Return tracked trials in one world, and that world; ConfigError without any.

    Args:
        entries: Planners of results folders.
        world: Number of the world in its data set.
        planners: Planners whose trials are returned; all if empty.
        outcome: Outcome that trials must have; any if empty.

    Raises:
        ConfigError: There is no such trial, or worlds of that number differ.
    """
    # Names first: a typing error must not read as a lack of trials.
    _require_selection(entries, world, planners, outcome)
    selection = []
    for entry in entries:
        if not planners or entry.planner in planners:
            is_selected = column(entry.results, "world") == world
            if outcome:
                is_selected &= column(entry.results, "outcome") == outcome
            selection.append(entry.select(is_selected))

    all_trials = read_trials(selection)
    trials = [trial for trial in all_trials if trial.track is not None]
    if not trials:
        reason = "none of its trials is of this kind"
        if all_trials:
            reason = "its trials have no tracks"
        raise ConfigError(f"world {world}: {reason}")
    first = trials[0]
    for trial in trials:
        if trial.result.world_checksum != first.result.world_checksum:
            paths = f"{first.entry.source.path} and {trial.entry.source.path}"
            raise ConfigError(f"world {world}: is not the same in {paths}")
    if isinstance(first.world, str):
        raise ConfigError(f"world {world}: {first.world}")
    return trials, first.world


def _require_selection(
    entries: Sequence[Entry], world: int, planners: Sequence[str], outcome: str
) -> None:
    """Raise ConfigError for planner or world without trials, or unknown outcome."""
    available = {entry.planner for entry in entries}
    # Any one of them will do for the message.
    for name in set(planners) - available:
        raise ConfigError(
            f"planner {name!r}: no trial here{suggest(name, available)}; "
            f"there are {', '.join(sorted(available))}"
        )
    outcomes = sorted(outcome.value for outcome in Outcome)
    if outcome and outcome not in outcomes:
        raise ConfigError(
            f"outcome {outcome!r}: must be one of {', '.join(outcomes)}"
            f"{suggest(outcome, outcomes)}"
        )
    numbers = sorted({result.world for entry in entries for result in entry.results})
    if world not in numbers:
        listed = ", ".join(map(str, numbers[:12]))
        raise ConfigError(f"world {world}: no trial; there are trials of {listed}")


def _draw_trial(
    axes: Axes, world: World, trial: DrivenTrial, by: str
) -> LineCollection:
    """Draw a trial's track, the robot at both ends and contacts; return the track."""
    assert trial.track is not None
    color = trial.entry.color
    poses = trial.poses
    corners_m = trial.entry.source.outline.corners_m
    speeds = trial.track.samples[:, _SPEED] if by == "speed" else None
    trail = drawing.draw_trail(axes, poses[:, :2], speeds, color)
    drawing.draw_outlines(
        axes, poses[[0, -1]], corners_m, color, linewidth=1.2, zorder=4
    )
    drawing.draw_contacts(axes, poses[trial.track.contact, :2])
    draw_touched_mover(axes, world, trial)
    return trail


def _overlay_handles(trials: Sequence[DrivenTrial], by: str) -> list[Line2D]:
    """Return legend entries: planners with outcomes, marks, and contact if any."""
    handles = []
    for entry in dict.fromkeys(trial.entry for trial in trials):
        counts = Counter(t.result.outcome.words for t in trials if t.entry is entry)
        parts = [f"{count} {name}" for name, count in counts.items()]
        text = f"{plain_text(entry.label)}\n{', '.join(parts)}"
        look: dict[str, Any] = {"color": entry.color, "linewidth": 2.0, "label": text}
        if by == "speed":
            # Speed colors the trajectories; the outlines have the planner's color.
            look |= {"linestyle": "", "marker": "s", "markerfacecolor": "none"}
        handles.append(Line2D([], [], **look))
    handles += [
        *_end_handles(),
        _legend_mark(
            "robot at both ends", color=INK, marker="s", markerfacecolor="none"
        ),
    ]
    if any(trial.track is not None and trial.track.contact.any() for trial in trials):
        handles.append(_legend_mark("contact", color=CONTACT, marker="x"))
    return handles
