"""Parameters of a planner tuned by Optuna in some worlds, and what holds of them in others, which it has not seen."""

import json
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import yaml
from matplotlib.figure import Figure
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    distribution_to_json,
)
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, Trial, TrialState

from barn_eval.analysis.compare import Comparison, adjust_by_holm, compare
from barn_eval.analysis.measures import COMPARED, MEASURES, require_measures
from barn_eval.analysis.verdict import conclude_comparison
from barn_eval.pages.figures import style, write_figure
from barn_eval.results.folder import order_worlds_fairly
from barn_eval.ros.work import require_ros, work_of
from barn_eval.running.parameter_files import read_parameters
from barn_eval.running.pool import WorkerPool
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import SCHEMA_VERSION, read_request
from barn_eval.running.run import Run, make_shared_pool, open_run
from barn_eval.running.settings import Setting, make_setting
from barn_eval.trials import identity
from barn_planners.registry import planner_config
from barn_worlds.base.config import as_dict, fields_of
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.files import write_bytes
from barn_worlds.base.text_files import read_yaml
from barn_worlds.datasets.dataset import open_dataset, select_worlds

Range = CategoricalDistribution | IntDistribution | FloatDistribution
_STEP = 5  # worlds, after each of which a setting may be given up
_MOST_UNSEEN, _MOST_KEPT = 100, 5
_RANGES = Path(__file__).parents[1] / "data" / "ranges"
_FILE_KEYS = {"schema_version", "parameters", "planner"}
_EARLY = "given up after"  # attribute of a setting: so many worlds


@dataclass(frozen=True)
class Ranges:
    """What parameters may be, by their names; planner: whose they are, empty for one that a command starts."""

    parameters: Mapping[str, Range]
    planner: str

    @classmethod
    def read(cls, name: str) -> "Ranges":
        """Return those of a YAML file, or of the suite by name; ConfigError where there are none.

        A range has low and high, both whole numbers or not, and log: true where it is drawn evenly over the logarithm;
        or choices.
        """
        path, known = Path(name), sorted(one.stem for one in _RANGES.glob("*.yaml"))
        if path.suffix not in (".yaml", ".yml"):
            if name not in known:
                raise ConfigError(
                    f"ranges {format_value(name)}: must be a YAML file or one of {', '.join(known)}"
                )
            path = _RANGES / f"{name}.yaml"
        content = read_yaml(path, SCHEMA_VERSION)
        found = content.get("parameters")
        if not isinstance(found, dict) or not found or content.keys() - _FILE_KEYS:
            raise ConfigError(
                f"{path}: must have parameters with their ranges, and may have a planner, nothing else"
            )
        return cls(
            {key: _range(one, f"{path}: {key}") for key, one in found.items()},
            content.get("planner", ""),
        )


def _range(about: dict[str, Any], where: str) -> Range:
    try:
        if "choices" in about:
            return CategoricalDistribution(**about)
        whole = isinstance(about["low"], int) and isinstance(about["high"], int)
        return (IntDistribution if whole else FloatDistribution)(**about)
    except (TypeError, ValueError, KeyError):
        raise ConfigError(
            f"{where}: must be low < high and perhaps log, or choices, got {format_value(about)}"
        ) from None


@dataclass(frozen=True)
class Tuned:
    """A setting that is worth keeping: its values, its means where it was chosen, and what holds of it elsewhere.

    unseen: it (a) against the default (b). files: of its parameters, ready to use.
    """

    number: int
    values: Mapping[str, Any]
    seen: Mapping[str, float]
    unseen: Comparison
    verdict: str
    files: Sequence[Path]


@dataclass(frozen=True)
class Tuning:
    """What was found: how many settings were tried and given up early, and those that are worth keeping.

    default: values of the parameters. default_seen: its means in the worlds that settings were chosen by. worlds,
    unseen: how many these are, and those that settings were judged in.
    """

    settings: int
    given_up: int
    default: Mapping[str, Any]
    default_seen: Mapping[str, float]
    worlds: int
    unseen: int
    tuned: Sequence[Tuned]


def tune(
    ranges: Ranges,
    options: Mapping[str, Any],
    unseen: str | None,
    by: Sequence[str],
    settings: int,
    reporter: Reporter,
) -> Tuning:
    """Try settings until there are so many, and judge the best by worlds that it was not chosen by.

    All is kept in the folder `options["out"]`, and not driven again. options: as of `read_request`. unseen: worlds to
    judge by, up to a hundred of the others unless given. by: measures; the protocol's metric unless given. Of several,
    settings are kept that no other is as good as by each. Raises BarnError for what is not possible.
    """
    tuner = _Tuner(ranges, options, by, unseen, reporter)
    study = tuner.study()
    direct = tuner.base.config.mode == "direct"
    with (
        closing(make_shared_pool(tuner.base.execution))
        if direct
        else nullcontext() as pool
    ):
        tuner.try_settings(study, settings, pool)
        trials = study.trials
        front = _front(study)
        tuned = tuner.judge(trials, front, pool)
    early = sum(_EARLY in one.user_attrs for one in trials)
    seen = dict(zip(tuner.by, trials[0].values, strict=True))
    return Tuning(
        len(trials),
        early,
        tuner.default,
        seen,
        len(tuner.worlds),
        len(tuner.unseen),
        tuned,
    )


class _Tuner:
    """What settings are made of and judged by; the rest is in the study and in folders of experiments."""

    def __init__(
        self,
        ranges: Ranges,
        options: Mapping[str, Any],
        by: Sequence[str],
        unseen: str | None,
        reporter: Reporter,
    ) -> None:
        self.ranges, self.reporter = ranges.parameters, reporter
        self.options = {
            **options,
            **({"planners": ranges.planner} if ranges.planner else {"mode": "ros"}),
        }
        self.base = read_request(None, self.options)
        require_ros(self.base.config, reporter)
        experiment = self.base.config
        self.by = require_measures(by) or (experiment.protocol.metric,)
        for key in self.by:
            if not MEASURES[key].better or MEASURES[key].successes_only:
                raise ConfigError(
                    f"--by {key}: must be known of every trial, and one way must be better"
                )
        indices = open_dataset(experiment.dataset).world_numbers
        self.worlds = order_worlds_fairly(select_worlds(experiment.worlds, indices))
        rest = [one for one in indices if one not in self.worlds]
        thinned = rest[:: ceil(len(rest) / _MOST_UNSEEN) or 1]
        self.unseen = (
            thinned if unseen is None else list(select_worlds(unseen, indices))
        )
        if not self.unseen or not set(self.unseen) <= set(rest):
            raise ConfigError(
                "--unseen: must be worlds, and none that settings are chosen by"
            )
        self.default = self._defaults()

    def _defaults(self) -> dict[str, Any]:
        planner = self.base.config.planners[0]
        known = (
            read_parameters(planner.command, list(self.ranges))
            if planner.command
            else {}
        )
        if planner.registered:
            setup = self.base.config.resolve_planner(planner)
            config = planner_config(planner.name, setup.preset, setup.overrides)
            known = {key: value for key, _, value in fields_of(config)}
        for key, one in self.ranges.items():
            if key not in known:
                raise ConfigError(
                    f"ranges: planner {planner.name!r} has no parameter {key!r}{suggest(key, known)}"
                )
            if one.single() or not one._contains(one.to_internal_repr(known[key])):
                raise ConfigError(
                    f"ranges: that of {key} must hold the default, {known[key]!r}"
                )
        return {key: known[key] for key in self.ranges}

    def study(self) -> optuna.Study:
        """Return the study of the folder, new or gone on with; ConfigError if it is another's."""
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        ranges = {key: distribution_to_json(one) for key, one in self.ranges.items()}
        tuned = {"ranges": ranges, "by": self.by, "unseen": self.unseen}
        asked = json.loads(json.dumps(as_dict(self.base.config) | tuned))
        ways = {"larger": StudyDirection.MAXIMIZE, "smaller": StudyDirection.MINIMIZE}
        self.base.out.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            study = optuna.create_study(
                storage=f"sqlite:///{self.base.out / 'study.db'}",
                pruner=optuna.pruners.WilcoxonPruner()
                if len(self.by) == 1
                else optuna.pruners.NopPruner(),
                study_name="barn tune",
                directions=[ways[MEASURES[key].better] for key in self.by],
                load_if_exists=True,
            )
        if found := identity.first_difference(
            study.user_attrs.get("asked", asked), asked
        ):
            raise ConfigError(
                "{}: holds another tuning: {} is {!r} there, {!r} here".format(
                    self.base.out, *found
                )
            )
        if not study.trials:
            study.set_user_attr("asked", asked)
            study.enqueue_trial(self.default)
        return study

    def try_settings(
        self, study: optuna.Study, settings: int, pool: WorkerPool | None
    ) -> None:
        """Try settings until so many are finished, from that on in whose midst it was stopped."""
        while (
            number := sum(one.state.is_finished() for one in study.trials)
        ) < settings:
            # a sampler of its own for each, so that what is gone on with is as if it had not been stopped
            study.sampler = optuna.samplers.TPESampler(
                seed=(self.base.config.seed + number) % 2**32
            )
            stopped = study.get_trials(states=[TrialState.RUNNING])
            trial = (
                Trial(study, stopped[0]._trial_id)
                if stopped
                else study.ask(dict(self.ranges))
            )
            try:
                values = self._try(study, trial, pool)
            except ConfigError as error:  # values that do not go together
                study.tell(trial, state=TrialState.FAIL)
                self.reporter.notify(f"setting {number}: {error}")
                continue
            study.tell(trial, values)
            measures = [MEASURES[key] for key in self.by]
            text = ", ".join(
                f"{one.title} {one.number(value)}"
                for one, value in zip(measures, values, strict=True)
            )
            if worlds := trial.user_attrs.get(_EARLY):
                worse = measures[0].number(abs(values[0] - study.best_value))
                text = f"given up after {worlds} worlds, {measures[0].title} {worse} worse there than the best"
            self.reporter.notify(f"setting {number} of {settings}: {text}")

    def _try(
        self, study: optuna.Study, trial: Trial, pool: WorkerPool | None
    ) -> list[float]:
        """Drive a setting until it is clearly worse than the best, and return its means."""
        told = dict(study.trials[trial.number].intermediate_values)
        with self._begun(self._setting(trial, "settings"), pool) as run:
            for count in range(_STEP, len(self.worlds) + _STEP, _STEP):
                seen = self.worlds[:count]
                results = run.drive_scored(seen)
                values = np.stack(
                    [MEASURES[key].values(results) for key in self.by], axis=1
                )
                if len(self.by) > 1:
                    continue
                for world in (one for one in seen if one not in told):
                    told[world] = float(
                        np.mean(
                            [
                                values[n]
                                for n, one in enumerate(results)
                                if one.world == world
                            ]
                        )
                    )
                    trial.report(told[world], world)
                if count < len(self.worlds) and trial.should_prune():
                    trial.set_user_attr(_EARLY, count)
                    best = study.best_trial.intermediate_values
                    # the best's mean over all worlds, and how much worse this is in those that it has driven
                    return [
                        float(
                            np.mean(list(best.values()))
                            + np.mean([told[one] - best[one] for one in seen])
                        )
                    ]
        return [float(one) for one in values.mean(axis=0)]

    def judge(
        self,
        trials: Sequence[FrozenTrial],
        front: Sequence[int],
        pool: WorkerPool | None,
    ) -> list[Tuned]:
        """Drive settings and the default in the worlds that they were not chosen by, and write what is to be kept."""
        results, keys = {}, tuple(dict.fromkeys((*self.by, *COMPARED)))
        kept = [one for one in front if one][:: ceil(len(front) / _MOST_KEPT) or 1]
        for number in (0, *kept):
            made = self._setting(
                trials[number], "unseen", worlds=",".join(map(str, self.unseen))
            )
            with self._begun(made, pool) as run:
                results[number] = run.drive_scored(self.unseen)
        compared = [
            compare(results[one], results[0], f"setting {one}", "default", keys)
            for one in kept
        ]
        if len(self.by) > 1:
            self._draw(trials, front)
        found = []
        for number, one in zip(
            kept, adjust_by_holm(compared) if kept else (), strict=True
        ):
            ranked, made = (
                replace(one, metric=self.by[0]),
                self._setting(trials[number], "settings"),
            )
            seen = dict(zip(self.by, trials[number].values, strict=True))
            verdict = str(conclude_comparison(ranked))
            found.append(
                Tuned(
                    number,
                    made.values,
                    seen,
                    ranked,
                    verdict,
                    self._write(number, made, verdict),
                )
            )
        return found

    def _write(self, number: int, made: Setting, verdict: str) -> list[Path]:
        """Write the parameters of a setting for use: a file for `barn run`, or the command's own files, changed."""
        planner, contents = (
            self.base.config.planners[0],
            list(made.parameter_files.values()),
        )
        if planner.registered:
            preset = self.base.config.resolve_planner(planner).preset
            chosen = {
                "name": planner.name,
                "preset": preset,
                "overrides": {**planner.overrides, **made.values},
            }
            file = {"schema_version": SCHEMA_VERSION, "planners": [chosen]}
            contents = [yaml.safe_dump(file, sort_keys=False).encode()]
        found = [
            self.base.out / f"tuned_{number:04}{'_' * bool(n)}{n or ''}.yaml"
            for n in range(len(contents))
        ]
        for path, content in zip(found, contents, strict=True):
            write_bytes(path, f"# barn tune: {verdict}\n".encode() + content)
        return found

    def _draw(self, trials: Sequence[FrozenTrial], front: Sequence[int]) -> None:
        """Draw all settings by the first two measures, the default, and those that no other is as good as."""
        others = [
            number
            for number, one in enumerate(trials)
            if number not in (0, *front) and one.values
        ]
        with style():
            figure = Figure(figsize=(5.0, 3.6), layout="constrained")
            axes = figure.add_subplot()
            for label, group, look in (
                ("settings", others, "o"),
                ("front", front, "o-"),
                ("default", [0], "D"),
            ):
                places = np.array(
                    [trials[number].values[:2] for number in group]
                ).reshape(-1, 2)
                axes.plot(*places.T, look, label=label)
            axes.set(
                xlabel=MEASURES[self.by[0]].heading, ylabel=MEASURES[self.by[1]].heading
            )
            axes.legend()
        write_figure(figure, self.base.out / "front.png")

    def _setting(
        self, trial: Trial | FrozenTrial, folder: str, worlds: str = ""
    ) -> Setting:
        """Return what drives a setting, its values of four digits; the first one is the default as it is."""
        values = {
            key: float(f"{one:.4g}") if isinstance(one, float) else one
            for key, one in trial.params.items()
        }
        base = self.base
        if worlds:
            base = replace(base, config=replace(base.config, worlds=worlds))
        return make_setting(
            base, values if trial.number else {}, f"{folder}/{trial.number:04}"
        )

    def _begun(
        self, made: Setting, pool: WorkerPool | None
    ) -> AbstractContextManager[Run]:
        made.write_parameter_files()
        return open_run(made.request, Reporter(), work_of, pool=pool)


def _front(study: optuna.Study) -> list[int]:
    """Return the numbers of the settings that no other is as good as, in order of the first measure."""
    found = (
        [study.best_trial]
        if len(study.directions) == 1
        else sorted(study.best_trials, key=lambda one: one.values)
    )
    return [one.number for one in found]
