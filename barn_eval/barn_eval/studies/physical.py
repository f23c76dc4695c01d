"""Fig. 8 of the paper: measured difficulty over the difficulty that the model predicts.

Results may be of any robot or simulator, as `barn judge` writes them. Folders of the
suite's own simulator in the same worlds may be added for comparison.
"""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from barn_eval.analysis.conventions import CONVENTIONS
from barn_eval.analysis.difficulty import TIME
from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.analysis.significance import t_quantile
from barn_eval.analysis.sources import (
    Source,
    group_by_planner,
    read_source,
    read_worlds,
    require_same_task,
)
from barn_eval.pages.figures import (
    MARKERS,
    label_axes,
    look_numbers,
    new_figure,
    style,
    write_figure,
)
from barn_eval.pages.template import render, write_page
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import LEVEL, Interval
from barn_metrics.model import load_model
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.base.files import make_json_safe, read_package_yaml
from barn_worlds.drawing.palette import INK
from barn_worlds.worlds.world import World

SCHEMA_VERSION = 1
FEWEST_WORLDS = 4
# Numbers of worlds for which the width of the interval is predicted.
_PLANNED_WORLDS = (5, 10, 20, 40, 80)

# Rows by checksum of their world, because data sets share numbers but not worlds.
_RowsByWorld = dict[str, list[TrialResult]]


@dataclass(frozen=True)
class WorldDifficulty:
    """A world's difficulty, predicted, measured and simulated [s/m]."""

    world: int
    checksum: str
    trials: int
    predicted_s_per_m: float
    # Standard deviation of trials in a new world around the prediction.
    predicted_std_s_per_m: float
    # Mean over planners, and the mean of each planner's trials.
    measured_s_per_m: float
    planners_s_per_m: dict[str, float]
    # Variance of the mean due to the noise of its trials; None without repetitions.
    noise_variance: float | None
    # Of the same planners in the suite's own simulator; None without their trials.
    simulated_s_per_m: float | None


@dataclass(frozen=True)
class Line:
    """A straight line through points, fitted by least squares."""

    slope: Interval
    intercept: Interval


@dataclass(frozen=True)
class PhysicalFinding:
    """Measured over predicted difficulty, with the line through the worlds."""

    system: str
    planners: Sequence[str]
    trials: int
    failures: int
    # From easy to difficult by prediction.
    worlds: Sequence[WorldDifficulty]
    line: Line
    # Of simulated over measured difficulty; None without enough simulated worlds.
    simulated_line: Line | None
    # Expected half-width of the slope's interval, by number of worlds.
    half_widths: dict[int, float]
    # Share of the scatter about the line due to the noise of trials; None without
    # repetitions.
    noise_share: float | None
    notes: Sequence[str]
    schema_version: int = SCHEMA_VERSION


def fit_line(x: Floats, y: Floats) -> Line:
    """Fit y over x by least squares, with 95% limits; ConfigError below three points.

    The standard error is the larger of the ordinary one and HC3, which allows for
    scatter that grows with x. Limits use Student's t with n - 2 degrees of freedom. A
    test simulates the coverage.

    Args:
        x: Predicted difficulty (n,), not all equal.
        y: Measured difficulty (n,).

    Returns:
        The line.

    Raises:
        ConfigError: If there are fewer than three points, or all x are equal.
    """
    points = len(x)
    if points < 3 or np.ptp(x) == 0.0:
        raise ConfigError(
            "a line needs at least three worlds that differ in difficulty"
        )
    design = np.column_stack([np.ones(points), x])
    inverse = np.linalg.inv(design.T @ design)
    coefficients = inverse @ design.T @ y
    residuals = y - design @ coefficients
    ordinary = inverse * (residuals @ residuals) / (points - 2)

    leverages = np.einsum("ij,jk,ik->i", design, inverse, design)
    # A point that alone determines the line has leverage 1 and no residual.
    weights = residuals / np.maximum(1.0 - leverages, 1e-9)
    meat = (design.T * weights**2) @ design
    robust = inverse @ meat @ inverse

    variances = np.maximum(np.diag(ordinary), np.diag(robust))
    reaches = _student_quantile(points) * np.sqrt(variances)
    limits = np.column_stack(
        [coefficients, coefficients - reaches, coefficients + reaches]
    )
    intercept, slope = (Interval(*row) for row in limits.tolist())
    return Line(slope, intercept)


def measure_difficulty(folders: Sequence[Path]) -> PhysicalFinding:
    """Compare measured with predicted difficulty; ConfigError below four worlds.

    Args:
        folders: Results of one robot or simulator; folders of the suite's own
            simulator, if there are others, count as simulated.

    Raises:
        ConfigError: If the folders do not go together, or have too few worlds.
        BarnError: If a folder cannot be read.
    """
    sources = [read_source(folder) for folder in folders]
    observed = [source for source in sources if source.system.is_observed]
    simulated = [source for source in sources if not source.system.is_observed]
    notes: list[str] = []
    if not observed:
        notes.append(
            "All trials are from the suite's own simulator; none were measured outside."
        )
        observed = simulated
        simulated = []
    for group in (observed, simulated):
        if group:
            require_same_task([source.path for source in group])

    measured_rows = _rows_by_world(observed)
    planners = sorted({row.planner for rows in measured_rows.values() for row in rows})
    simulated_rows = _rows_by_world(simulated)
    worlds = read_worlds((row, source) for source in observed for row in source.results)

    difficulties = []
    for checksum, rows in measured_rows.items():
        difficulty = _measure_world(
            worlds[checksum], planners, rows, simulated_rows.get(checksum, []), notes
        )
        if difficulty is not None:
            difficulties.append(difficulty)
    if len(difficulties) < FEWEST_WORLDS:
        need = (
            f"{observed[0].path}: has {len(difficulties)} worlds that can be predicted,"
            f" driven by all of {', '.join(planners)}; at least {FEWEST_WORLDS} are"
            " needed."
        )
        raise ConfigError(" ".join([need, *notes]))
    difficulties.sort(key=lambda world: world.predicted_s_per_m)

    rows = [row for world in difficulties for row in measured_rows[world.checksum]]
    predicted = np.array([world.predicted_s_per_m for world in difficulties])
    measured = np.array([world.measured_s_per_m for world in difficulties])
    line = fit_line(predicted, measured)

    simulated_line = None
    # NaN for None.
    x = np.array([world.simulated_s_per_m for world in difficulties], np.float64)
    is_known = np.isfinite(x)
    if is_known.sum() >= FEWEST_WORLDS:
        simulated_line = fit_line(x[is_known], measured[is_known])

    return PhysicalFinding(
        system=observed[0].system.name,
        planners=planners,
        trials=len(rows),
        failures=sum(not row.scores.success for row in rows),
        worlds=difficulties,
        line=line,
        simulated_line=simulated_line,
        half_widths=_foretell_half_widths(line, len(difficulties)),
        noise_share=_noise_share(line, difficulties),
        notes=notes,
    )


def _foretell_half_widths(line: Line, worlds: int) -> dict[int, float]:
    """Return the slope's expected half-width for several numbers of similar worlds."""
    assert line.slope.high is not None
    half_width = line.slope.high - line.slope.estimate
    error_of_one = half_width / _student_quantile(worlds) * math.sqrt(worlds)
    return {
        number: _student_quantile(number) * error_of_one / math.sqrt(number)
        for number in _PLANNED_WORLDS
    }


def _noise_share(line: Line, worlds: Sequence[WorldDifficulty]) -> float | None:
    """Return trials' noise as a share of the scatter; None if unknown or no scatter."""
    scatter = 0.0
    noise = 0.0
    for world in worlds:
        if world.noise_variance is None:
            return None
        height = line.intercept.estimate + line.slope.estimate * world.predicted_s_per_m
        scatter += (world.measured_s_per_m - height) ** 2 / (len(worlds) - 2)
        noise += world.noise_variance / len(worlds)
    if scatter == 0.0:
        return None
    return min(noise / scatter, 1.0)


def _student_quantile(points: int) -> float:
    """Return the 97.5% quantile of Student's t for a line through that many points."""
    return t_quantile(0.5 + 0.5 * LEVEL, points - 2)


def _rows_by_world(sources: Iterable[Source]) -> _RowsByWorld:
    """Return rows with a time per meter by world checksum, without reference drives."""
    groups: _RowsByWorld = {}
    for source in sources:
        for row in source.results:
            is_known = row.scores.normalised_time_s_per_m is not None
            # A teleoperated drive is a reference, not one of a planner.
            is_known &= row.planner != CONVENTIONS["finals"].reference
            if row.world_checksum and is_known:
                groups.setdefault(row.world_checksum, []).append(row)
    return groups


def _measure_world(
    world: World | str,
    planners: Sequence[str],
    rows: Sequence[TrialResult],
    simulated_rows: Sequence[TrialResult],
    notes: list[str],
) -> WorldDifficulty | None:
    """Return a world's difficulty; if it is left out, append a note and return None.

    A text in place of the world says why it cannot be read.
    """
    if isinstance(world, str):
        notes.append(world[0].upper() + world[1:] + ".")
        return None
    number = rows[0].world
    groups = group_by_planner(rows)
    missing = [planner for planner in planners if planner not in groups]
    if missing:
        notes.append(f"World {number} is left out: {', '.join(missing)} did not drive.")
        return None
    try:
        prediction = load_model().predict(world)
    except WorldError as error:
        notes.append(f"World {number} is left out: {error}.")
        return None

    means = {}
    variances = []
    for planner in planners:
        times = TIME.values(groups[planner])
        means[planner] = float(times.mean())
        if len(times) > 1:
            variances.append(float(times.var(ddof=1)) / len(times))
    noise_variance = None
    if len(variances) == len(planners):
        noise_variance = sum(variances) / len(planners) ** 2

    simulated = group_by_planner(simulated_rows)
    simulated_s_per_m = None
    if all(planner in simulated for planner in planners):
        simulated_s_per_m = float(
            np.mean([TIME.values(simulated[planner]).mean() for planner in planners])
        )
    return WorldDifficulty(
        world=number,
        checksum=world.checksum,
        trials=len(rows),
        predicted_s_per_m=prediction.difficulty_s_per_m,
        predicted_std_s_per_m=prediction.std_s_per_m,
        measured_s_per_m=float(np.mean(list(means.values()))),
        planners_s_per_m=means,
        noise_variance=noise_variance,
        simulated_s_per_m=simulated_s_per_m,
    )


def write_finding(finding: PhysicalFinding, folder: Path) -> Path:
    """Write physical.md, physical.json and figures/physical.png; return the page's path.

    Args:
        finding: The finding.
        folder: Folder to write to; created if missing.

    Raises:
        StoreError: If a file cannot be written.
    """
    with style():
        figure = draw_finding(finding)
    write_figure(figure, folder / "figures" / "physical.png")
    content = json.dumps(make_json_safe(as_dict(finding)), indent=1, allow_nan=False)
    write_page(folder / "physical.json", f"{content}\n")
    path = folder / "physical.md"
    paper = read_package_yaml("barn_eval", "paper.yaml")["physical"]
    write_page(path, render("physical.md", finding=finding, paper=paper))
    return path


def draw_finding(finding: PhysicalFinding) -> Figure:
    """Return a figure of each planner's measured over predicted difficulty, with the line.

    Args:
        finding: The finding.
    """
    figure = new_figure(4.6)
    axes = figure.subplots()
    colors = assign_colors(finding.planners)
    predicted = np.array([world.predicted_s_per_m for world in finding.worlds])
    looks = zip(finding.planners, colors, look_numbers(colors), strict=True)
    for planner, color, number in looks:
        axes.scatter(
            predicted,
            [world.planners_s_per_m[planner] for world in finding.worlds],
            s=22,
            color=color,
            marker=MARKERS[number],
            label=spelling(planner),
        )
    line = finding.line
    ends = np.array([predicted.min(), predicted.max()])
    axes.plot(
        ends,
        line.intercept.estimate + line.slope.estimate * ends,
        color=INK,
        label=f"slope {line.slope.text()}",
    )
    axes.plot(ends, ends, color=INK, lw=1.0, ls="--", label="measured as predicted")
    label_axes(axes, "predicted difficulty [s/m]", "measured difficulty [s/m]")
    axes.legend(loc="best")
    return figure
