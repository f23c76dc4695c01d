"""Tuning: Optuna selects parameters in some worlds; they are judged in others."""

import json
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    distribution_to_json,
)
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, Trial, TrialState

from barn_eval.analysis.compare import Comparison, adjust_by_holm, compare
from barn_eval.analysis.difficulty import means_by_world
from barn_eval.analysis.measures import COMPARED, MEASURES, require_measures
from barn_eval.analysis.verdict import conclude_comparison
from barn_eval.pages.figures import new_figure, style, write_figure
from barn_eval.results.folder import order_worlds_fairly
from barn_eval.ros.work import require_ros, work_of
from barn_eval.running.pool import WorkerPool
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import SCHEMA_VERSION, read_request
from barn_eval.running.run import Run, make_shared_pool, open_run
from barn_eval.running.settings import Setting, make_setting, read_parameters
from barn_eval.trials import identity
from barn_planners.registry import planner_config
from barn_worlds.base.config import as_dict, fields_of
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.files import dump_yaml, read_yaml, write_bytes
from barn_worlds.datasets.dataset import select_worlds

Range = CategoricalDistribution | IntDistribution | FloatDistribution
RANGES_FOLDER = Path(__file__).parents[1] / "data" / "ranges"
_FILE_KEYS = {"schema_version", "parameters", "planner"}
_STEP = 5  # worlds; after each step a setting may be stopped
_MAX_UNSEEN = 100
_MAX_FRONT = 5
# Attribute of a setting that was stopped early: the number of worlds that it drove in.
_GIVEN_UP = "given up after"
_DIRECTIONS = {"larger": StudyDirection.MAXIMIZE, "smaller": StudyDirection.MINIMIZE}


@dataclass(frozen=True)
class Ranges:
    """Allowed values of parameters."""

    # By name of the parameter.
    parameters: Mapping[str, Range]
    # Planner of the suite that has them; empty for one that a command starts.
    planner: str

    @classmethod
    def read(cls, name: str) -> "Ranges":
        """Read ranges of a YAML file or the suite's planner; ConfigError if wrong.

        A range has choices, or low and high (whole numbers or not) and, to draw evenly
        over the logarithm, log: true.

        Raises:
            ConfigError: If there is no such file, or its content is wrong.
        """
        path = Path(name)
        if path.suffix not in (".yaml", ".yml"):
            names = sorted(file.stem for file in RANGES_FOLDER.glob("*.yaml"))
            if name not in names:
                raise ConfigError(
                    f"ranges {format_value(name)}: must be a YAML file or one of"
                    f" {', '.join(names)}"
                )
            path = RANGES_FOLDER / f"{name}.yaml"

        content = read_yaml(path, SCHEMA_VERSION)
        ranges = content.get("parameters")
        if not isinstance(ranges, dict) or not ranges or content.keys() - _FILE_KEYS:
            raise ConfigError(
                f"{path}: must have the key parameters and may have the key planner; other keys are not allowed"
            )
        parameters = {
            key: _parse_range(content, f"{path}: {key}")
            for key, content in ranges.items()
        }
        return cls(parameters, content.get("planner", ""))


def _parse_range(content: dict[str, Any], subject: str) -> Range:
    """Return the Optuna distribution of a YAML range; ConfigError if it is wrong."""
    try:
        if "choices" in content:
            return CategoricalDistribution(**content)
        if isinstance(content["low"], int) and isinstance(content["high"], int):
            return IntDistribution(**content)
        return FloatDistribution(**content)
    except (TypeError, ValueError, KeyError):
        raise ConfigError(
            f"{subject}: must have low < high and optionally log, or choices, got"
            f" {format_value(content)}"
        ) from None


@dataclass(frozen=True)
class Tuned:
    """A setting worth keeping, compared with the default."""

    # Number of the setting; 0 is the default.
    number: int
    values: Mapping[str, Any]
    # Means by measure in the worlds that it was selected in.
    seen: Mapping[str, float]
    # The setting (a) compared with the default (b) in other worlds, and the conclusion.
    unseen: Comparison
    verdict: str
    # Files with its parameters.
    files: Sequence[Path]


@dataclass(frozen=True)
class Tuning:
    """The result of a tuning."""

    # Number of settings, and of those that were stopped early.
    settings: int
    given_up: int
    # Values of the default, and its means in the worlds that settings are selected in.
    default: Mapping[str, Any]
    default_seen: Mapping[str, float]
    # Number of worlds that settings are selected in, and judged in.
    worlds: int
    unseen: int
    tuned: Sequence[Tuned]


class Tuner:
    """Makes, drives and judges settings; results stay in the study and run folders."""

    def __init__(
        self,
        ranges: Ranges,
        options: Mapping[str, Any],
        by: Sequence[str],
        unseen: str | None,
        reporter: Reporter,
    ):
        """Check ranges, measures and worlds for `tune`; BarnError if an option is wrong.

        Args:
            ranges: Allowed values of parameters.
            options: Options of the run, as `read_request` takes them.
            by: Measures to select by. Default: the protocol's ranking measure. With
                several, the settings of their Pareto front are judged.
            unseen: Worlds to judge in. Default: up to a hundred of the other worlds.
            reporter: Receives a line about each setting.
        """
        self.ranges = ranges.parameters
        self.reporter = reporter
        # In mode direct, all runs share these workers.
        self.pool: WorkerPool | None = None
        planner: dict[str, Any] = {"mode": "ros"}
        if ranges.planner:
            planner = {"planners": ranges.planner}
        # The run of the default, in the worlds that settings are selected in.
        self.base = read_request(None, {**options, **planner})
        config = self.base.config
        require_ros(config, reporter)

        self.by = require_measures(by) or (self.base.trials()[0].metric,)
        for key in self.by:
            if not MEASURES[key].better or MEASURES[key].successes_only:
                raise ConfigError(
                    f"--by {key}: must be a measure that every trial has and that is"
                    " better when larger or smaller"
                )

        numbers = self.base.dataset.world_numbers
        # Settings may be stopped after a few worlds, so these must be like the rest.
        self.worlds = order_worlds_fairly(select_worlds(config.worlds, numbers))
        other_worlds = [number for number in numbers if number not in self.worlds]
        if unseen is not None:
            self.unseen = list(select_worlds(unseen, numbers))
        else:
            self.unseen = _thin(other_worlds, len(other_worlds) / _MAX_UNSEEN)
        if not self.unseen or not set(self.unseen) <= set(other_worlds):
            raise ConfigError(
                "--unseen: must be worlds of the data set that are not in --worlds"
            )
        self.default = self._read_default()

    def _read_default(self) -> dict[str, Any]:
        """Return current values of the keys in `ranges`; ConfigError if not allowed.

        Raises ConfigError for an unknown parameter, or a value outside its range.
        """
        planner = self.base.config.planners[0]
        values: dict[str, Any] = {}
        if planner.registered:
            setup = self.base.config.resolve_planner(planner)
            config = planner_config(planner.entry_name, setup.preset, setup.overrides)
            values = {key: value for key, _, value in fields_of(config)}
        elif planner.command:
            values = read_parameters(planner.command, list(self.ranges))

        for key, allowed in self.ranges.items():
            if key not in values:
                raise ConfigError(
                    f"ranges: planner {planner.name!r} has no parameter {key!r}"
                    f"{suggest(key, values)}"
                )
            # Optuna does not check enqueued values, and has no public function for it.
            is_allowed = allowed._contains(allowed.to_internal_repr(values[key]))
            if allowed.single() or not is_allowed:
                raise ConfigError(
                    f"ranges: {key} must allow the default, {values[key]!r}, and other"
                    " values"
                )
        return {key: values[key] for key in self.ranges}

    @cached_property
    def study(self) -> optuna.Study:
        """Optuna's study in OUT/study.db, created or loaded; ConfigError if of others.

        Raises:
            ConfigError: If the folder holds a different tuning run.
        """
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self.base.out.mkdir(parents=True, exist_ok=True)
        # With several measures there is no best setting to prune against.
        pruner: optuna.pruners.BasePruner = optuna.pruners.NopPruner()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            if len(self.by) == 1:
                # It compares two settings in the worlds that both drove in, because all
                # have the same order.
                pruner = optuna.pruners.WilcoxonPruner()
            study = optuna.create_study(
                storage=f"sqlite:///{self.base.out / 'study.db'}",
                pruner=pruner,
                study_name="barn tune",
                directions=[_DIRECTIONS[MEASURES[key].better] for key in self.by],
                load_if_exists=True,
            )

        ranges = {key: distribution_to_json(item) for key, item in self.ranges.items()}
        tuning = {"ranges": ranges, "by": self.by, "unseen": self.unseen}
        # Through JSON, as the study stores it.
        content = json.loads(json.dumps(as_dict(self.base.config) | tuning))
        earlier = study.user_attrs.get("asked", content)
        difference = identity.first_difference(earlier, content)
        if difference:
            key, earlier_value, value = difference
            raise ConfigError(
                f"{self.base.out}: holds a different tuning run: {key} is {earlier_value!r}"
                f" there, {value!r} here"
            )
        if not study.trials:
            study.set_user_attr("asked", content)
            study.enqueue_trial(self.default)
        return study

    def tune(self, settings: int) -> Tuning:
        """Drive or resume Optuna's settings, then judge the best in other worlds.

        All results are kept in the folder `options["out"]`, so the same call resumes
        there.

        Args:
            settings: Number of settings, including the default.

        Returns:
            The settings worth keeping, and the counts of settings and worlds.

        Raises:
            BarnError: If the folder holds a different tuning run.
        """
        # Before workers start, because the folder may hold another run.
        study = self.study
        with make_shared_pool(self.base) as self.pool:
            self.try_settings(settings)
            tuned = self.judge()
        trials = study.trials
        return Tuning(
            settings=len(trials),
            given_up=sum(_GIVEN_UP in trial.user_attrs for trial in trials),
            default=self.default,
            default_seen=self.means(trials[0]),
            worlds=len(self.worlds),
            unseen=len(self.unseen),
            tuned=tuned,
        )

    def try_settings(self, settings: int) -> None:
        """Drive settings until the study has `settings` finished ones; report each.

        An interrupted setting is resumed first. A setting whose values do not go
        together counts as finished.
        """
        study = self.study
        while True:
            number = sum(trial.state.is_finished() for trial in study.trials)
            if number >= settings:
                return
            # Each setting has its own sampler, so a resumed study draws the same
            # settings as one that was not interrupted.
            seed = (self.base.config.seed + number) % 2**32
            study.sampler = optuna.samplers.TPESampler(seed=seed)
            # If the process was killed, its setting is still "running"; resume it.
            interrupted = study.get_trials(states=[TrialState.RUNNING])
            if interrupted:
                trial = Trial(study, interrupted[0]._trial_id)
            else:
                trial = study.ask(dict(self.ranges))

            try:
                means = self._try(trial)
            except ConfigError as error:
                # Values that do not go together.
                study.tell(trial, state=TrialState.FAIL)
                self.reporter.notify(f"setting {number}: {error}")
                continue
            study.tell(trial, means)
            text = self._describe(trial, means)
            self.reporter.notify(f"setting {number} of {settings}: {text}")

    def _describe(self, trial: Trial, means: Sequence[float]) -> str:
        """Return a line on a driven setting: its means, or why it was stopped early."""
        measures = [MEASURES[key] for key in self.by]
        worlds = trial.user_attrs.get(_GIVEN_UP)
        if worlds:
            gap = measures[0].number(abs(means[0] - self.study.best_value))
            return (
                f"stopped after {worlds} worlds, with {measures[0].title} {gap} worse"
                " than the best"
            )
        return ", ".join(
            f"{measure.title} {measure.number(mean)}"
            for measure, mean in zip(measures, means, strict=True)
        )

    def _try(self, trial: Trial) -> list[float]:
        """Drive a setting until done or clearly worse; return a mean per measure.

        The mean of a setting that was stopped early is an estimate for all worlds. With
        one measure, the study gets the means by world. With several, no setting is
        stopped.
        """
        world_means = dict(self.study.trials[trial.number].intermediate_values)
        with self._open_run(self.make_setting(trial, "settings")) as run:
            for count in range(_STEP, len(self.worlds) + _STEP, _STEP):
                worlds = self.worlds[:count]
                results = run.drive_scored(worlds)
                if len(self.by) > 1:
                    continue

                means = means_by_world(results, MEASURES[self.by[0]])
                for world in worlds:
                    if world not in world_means:
                        world_means[world] = means[world]
                        trial.report(means[world], world)
                if count < len(self.worlds) and trial.should_prune():
                    trial.set_user_attr(_GIVEN_UP, count)
                    # The best setting's mean, plus the mean difference in the worlds
                    # that both drove in.
                    best = self.study.best_trial.intermediate_values
                    differences = [world_means[world] - best[world] for world in worlds]
                    best_mean = np.mean(list(best.values()))
                    return [float(best_mean + np.mean(differences))]
        return [float(MEASURES[key].values(results).mean()) for key in self.by]

    def judge(self) -> list[Tuned]:
        """Drive the best settings in unseen worlds, write files, return comparisons or [].

        This writes parameter files of the best settings and, with several measures,
        front.png.

        Returns:
            The best settings, in the order of the first measure; empty if the default is
            the best.
        """
        trials = self.study.trials
        front = _front(self.study)
        candidates = [number for number in front if number != 0]
        candidates = _thin(candidates, len(front) / _MAX_FRONT)

        results = {}
        worlds = ",".join(map(str, self.unseen))
        for number in (0, *candidates):
            setting = self.make_setting(trials[number], "unseen", worlds)
            with self._open_run(setting) as run:
                results[number] = run.drive_scored(self.unseen)
        keys = tuple(dict.fromkeys((*self.by, *COMPARED)))
        comparisons = [
            compare(results[number], results[0], f"setting {number}", "default", keys)
            for number in candidates
        ]
        if len(self.by) > 1:
            self._draw_front(trials, front)
        if not comparisons:
            return []
        # The best of several settings is partly luck; the correction allows for that.
        adjusted = adjust_by_holm(comparisons)
        tuned = []
        for number, comparison in zip(candidates, adjusted, strict=True):
            by_first = replace(comparison, metric=self.by[0])
            verdict = str(conclude_comparison(by_first))
            setting = self.make_setting(trials[number], "settings")
            files = self.write_files(number, setting, verdict)
            means = self.means(trials[number])
            tuned.append(Tuned(number, setting.values, means, by_first, verdict, files))
        return tuned

    def means(self, trial: FrozenTrial) -> dict[str, float]:
        """Return a setting's means by measure, estimates if it was stopped early."""
        return dict(zip(self.by, trial.values, strict=True))

    def write_files(self, number: int, setting: Setting, verdict: str) -> list[Path]:
        """Write OUT/tuned_NUMBER.yaml, and further files if needed; return the paths.

        Args:
            number: Number of the setting.
            setting: Its values and parameter files.
            verdict: Conclusion of the comparison with the default.

        Returns:
            A file for `barn run`, or the changed parameter files of the command.
        """
        planner = self.base.config.planners[0]
        contents = list(setting.parameter_files.values())
        if planner.registered:
            entry = {
                "name": planner.name,
                "preset": self.base.config.resolve_planner(planner).preset,
                "overrides": {**planner.overrides, **setting.values},
            }
            if planner.entry:
                entry["entry"] = planner.entry
            content = {"schema_version": SCHEMA_VERSION, "planners": [entry]}
            contents = [dump_yaml(content).encode()]

        paths = []
        for place, content_bytes in enumerate(contents):
            ending = f"_{place}" if place else ""
            path = self.base.out / f"tuned_{number:04}{ending}.yaml"
            write_bytes(path, f"# barn tune: {verdict}\n".encode() + content_bytes)
            paths.append(path)
        return paths

    def _draw_front(self, trials: Sequence[FrozenTrial], front: Sequence[int]) -> None:
        """Write OUT/front.png: all settings by two measures, front and default marked."""
        dominated = []
        for trial in trials:
            if trial.values and trial.number not in (0, *front):
                dominated.append(trial.number)
        groups = (
            ("settings", dominated, "o"),
            ("front", front, "o-"),
            ("default", [0], "D"),
        )
        with style():
            figure = new_figure(3.6, 5.0)
            axes = figure.add_subplot()
            for label, numbers, line_format in groups:
                means = [trials[number].values[:2] for number in numbers]
                x, y = np.array(means).reshape(-1, 2).T
                axes.plot(x, y, line_format, label=label)
            first, second = (MEASURES[key].heading for key in self.by[:2])
            axes.set(xlabel=first, ylabel=second)
            axes.legend()
        write_figure(figure, self.base.out / "front.png")

    def make_setting(
        self, trial: Trial | FrozenTrial, folder: str, worlds: str = ""
    ) -> Setting:
        """Return the setting of a study's trial, floats to 4 digits; 0 is the default.

        Args:
            trial: Trial of the study. Its floats are rounded to four digits; the first
                trial is the unchanged default.
            folder: Folder of settings below that of the tuning.
            worlds: Worlds. Default: those that settings are selected in.
        """
        base = self.base
        if worlds:
            base = replace(base, config=replace(base.config, worlds=worlds))
        values: dict[str, Any] = {}
        if trial.number:
            for key, value in trial.params.items():
                values[key] = value
                if isinstance(value, float):
                    # People read the files, and a fifth digit changes no planner.
                    values[key] = float(f"{value:.4g}")
        return make_setting(base, values, f"{folder}/{trial.number:04}")

    def _open_run(self, setting: Setting) -> AbstractContextManager[Run]:
        """Write a setting's parameter files; return the context manager of its run."""
        setting.write_parameter_files()
        return open_run(setting.request, Reporter(), work_of, pool=self.pool)


def _front(study: optuna.Study) -> list[int]:
    """Return the numbers of Pareto-optimal settings by their first mean, smallest first.

    With one measure, this is the number of the best setting alone.
    """
    if len(study.directions) == 1:
        return [study.best_trial.number]
    best_trials = sorted(study.best_trials, key=lambda trial: trial.values)
    return [trial.number for trial in best_trials]


def _thin(numbers: Sequence[int], step: float) -> list[int]:
    """Return every n-th number, beginning with the first; n is `step` rounded up."""
    return list(numbers[:: ceil(step) or 1])
