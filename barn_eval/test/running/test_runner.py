"""The order of trials, what becomes of lost ones, and the tables, with an engine that
does as it is told.
"""

import csv
import resource
import shutil
from collections import Counter
from dataclasses import replace

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from campaign_runs import tables
from refusals import refused

from barn_eval.results.folder import ResultsFolder, read_results
from barn_eval.results.rows import RowFile
from barn_eval.results.store import BagStore, TrialRecord
from barn_eval.results.tracks import track_line
from barn_eval.running.pool import (
    DirectWork,
    Job,
    JobLoss,
    JobRefusal,
    JobResult,
    PartialResult,
    WorkerPool,
)
from barn_eval.running.run import describe_unscored
from barn_eval.running.runner import RunError, TrialLoss, run_trials
from barn_eval.trials.result import Outcome, Verdict, WallClock
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.trajectory import Trajectory
from barn_eval.trials.trial import finish_trial
from barn_worlds.base.errors import StoreError

ENDED_AT = "2026-01-01T00:00:00.000+00:00"


def driven(spec, clock=0.0):
    """Return a finished trial that depends on the trial's seeds only, apart from its
    wall-clock figures.
    """
    draw = np.random.default_rng([spec.simulator_seed, spec.planner_seed])
    count = 50
    truth = np.cumsum(draw.uniform(0.0, 0.1, (count, 3)), axis=0)
    stamps_ns = np.arange(count) * 50_000_000
    speeds = draw.uniform(0, 0.5, (count, 2))
    trajectory = Trajectory(
        stamps_ns,
        truth,
        speeds,
        np.ones((count, 2)),
        np.zeros(count, bool),
        np.full(count, np.nan),
        np.ones(count, np.int64),
    )
    outcome = Outcome.SUCCESS if draw.random() < 0.8 else Outcome.TIMEOUT
    verdict = Verdict(outcome, "", float(draw.uniform(10, 40)), 45.0, 0.0)
    return finish_trial(
        spec, "direct", verdict, trajectory, wall_clock=WallClock(duration_s=clock)
    )


def finished(spec, clock=0.0):
    return driven(spec, clock).result


def record(spec, clock=0.0):
    """Return what a worker reports of a trial."""
    return TrialRecord(finished(spec, clock), track_line(driven(spec, clock)))


class Scripted(WorkerPool):
    """Answers jobs in an order of its own.

    `fate` may turn an attempt into something else than a result.
    """

    def __init__(self, slots=3, seed=0, fate=lambda key, attempt, result: result):
        self._slots = slots
        self.fate = fate
        self.draw = np.random.default_rng(seed)
        self.out = {}
        self.attempts = Counter()
        self.order = []
        self.closed = False

    @property
    def slots(self):
        return self._slots

    def submit(self, key, job):
        assert len(self.out) < self._slots
        assert key not in self.out
        self.out[key] = job
        self.order.append(key)

    def wait(self, limit_s):
        key = list(self.out)[self.draw.integers(len(self.out))]
        job = self.out.pop(key)
        self.attempts[key] += 1
        trial = record(job.trials[0], float(self.draw.random()))
        done = JobResult(key, "scripted", trial, ENDED_AT)
        return [self.fate(key, self.attempts[key], done)]

    def close(self):
        self.closed = True


@pytest.fixture(scope="module")
def config():
    return RunConfig(
        worlds="0,50",
        planners=(PlannerChoice("gap"), PlannerChoice("dwa")),
        repetitions=2,
        seed=3,
    )


@pytest.fixture(scope="module")
def specs(config):
    return config.trials()


def run(path, config, specs, engine, mode="direct", **execution):
    execution = ExecutionConfig(**execution)
    work = DirectWork(BagStore(path))
    with ResultsFolder.open(path, config, execution, specs) as folder:
        events = list(
            run_trials(folder, folder.remaining, engine, execution, work, mode)
        )
        folder.complete()
    return events


def lost_if(condition, **what):
    def fate(key, attempt, result):
        return (
            JobLoss(key, "scripted", "it was told to", **what)
            if condition(key, attempt)
            else result
        )

    return fate


def test_order_and_losses_change_no_byte_of_the_table(tmp_path, config, specs):
    run(tmp_path / "a", config, specs, Scripted(slots=1))
    fate = lost_if(lambda key, attempt: attempt == 1)
    run(tmp_path / "b", config, specs, Scripted(slots=4, seed=9, fate=fate))
    a, b = tmp_path / "a", tmp_path / "b"
    assert tables(a) == tables(b)
    for name in ("timing.parquet", "timing.csv"):
        assert (a / name).read_bytes() != (b / name).read_bytes()


def test_a_lost_trial_is_tried_again_and_the_loss_is_noted(tmp_path, config, specs):
    key = specs[2].trial_id
    fate = lost_if(
        lambda name, attempt: name == key and attempt < 3, traceback="Traceback of it"
    )
    events = run(tmp_path, config, specs, Scripted(fate=fate))
    first, second, result = (event for event in events if event.trial_id == key)
    assert first == TrialLoss(key, 1, "it was told to")
    assert second == TrialLoss(key, 2, "it was told to")
    assert [event for event in events if isinstance(event, TrialLoss)] == [
        first,
        second,
    ]
    assert (result.wall_clock.attempts, result.wall_clock.worker) == (3, "scripted")
    assert result.repeatable() == finished(specs[2]).repeatable()
    note = (tmp_path / "losses" / f"{key}.txt").read_text()
    assert note.count("it was told to") == 2
    assert "attempt 2 on scripted" in note
    assert "Traceback of it" in note


@pytest.mark.parametrize(
    "overtime, outcome",
    [(False, Outcome.PLANNER_DIED), (True, Outcome.PLANNER_STALLED)],
)
def test_a_trial_lost_at_every_attempt_is_a_failure(
    tmp_path, config, specs, overtime, outcome
):
    key = specs[1].trial_id
    engine = Scripted(
        fate=lost_if(lambda name, attempt: name == key, is_overtime=overtime)
    )
    run(tmp_path, config, specs, engine, attempts=2)
    assert engine.attempts[key] == 2
    table = pyarrow.parquet.read_table(tmp_path / "results.parquet").to_pylist()
    (row,) = (row for row in table if row["trial_id"] == key)
    expected = {
        "outcome": outcome.value,
        # which shares the worker's process, and could end it to escape its score
        "fault": "planner",
        "detail": "it was told to, at the last of 2 attempts",
        "success": False,
        "traversal_time_s": None,
        "scored_time_s": config.protocol.failure_time_s,
        "simulator_seed": specs[1].simulator_seed,
    }
    assert row | expected == row


def test_faults_of_the_set_up_are_kept_apart_named_and_run_again(
    tmp_path, config, specs
):
    key = specs[1].trial_id
    engine = Scripted(fate=lost_if(lambda name, attempt: name == key))
    run(tmp_path / "x", config, specs, engine, "ros", attempts=2)
    whole = pyarrow.csv.read_csv(tmp_path / "x" / "results.csv").to_pylist()
    died = [row for row in whole if row["outcome"] == "simulator_died"]
    assert {row["trial_id"]: row["fault"] for row in died} == {key: "simulator"}
    scored = read_results(tmp_path / "x")
    names = {spec.trial_id for spec in specs}
    assert {result.trial_id for result in scored} == names - {key}
    unscored = (row for row in RowFile(tmp_path / "x").read() if not row.is_scored)
    assert describe_unscored([*scored, *unscored]) == (
        f"1 of {len(specs)} trials failed through no fault of the planner and are not scored; "
        "the same command runs them again: "
        f"{key} (simulator: it was told to, at the last of 2 attempts)"
    )
    again = run(tmp_path / "x", config, specs, Scripted())
    assert [event.trial_id for event in again] == [key]
    run(tmp_path / "undisturbed", config, specs, Scripted())
    assert tables(tmp_path / "x") == tables(tmp_path / "undisturbed")
    assert describe_unscored(read_results(tmp_path / "x")) == ""


def test_many_losses_in_a_row_stop_the_campaign(tmp_path, config, specs):
    engine = Scripted(fate=lost_if(lambda name, attempt: True))
    words = "4 attempts in a row were lost; last reason: it was told to"
    with refused(words, RunError):
        run(tmp_path, config, specs, engine, losses=4)
    run(tmp_path, config, specs, Scripted())
    table = pyarrow.parquet.read_table(tmp_path / "results.parquet")
    assert table.num_rows == len(specs)


def test_a_users_mistake_stops_the_run_and_keeps_results(tmp_path, config, specs):
    key = specs[-1].trial_id

    def fate(name, attempt, result):
        return JobRefusal(name, "scripted", "no such preset") if name == key else result

    with refused(f"{key}: no such preset", RunError):
        run(tmp_path, config, specs, Scripted(slots=1, fate=fate))
    assert (tmp_path / "results.jsonl").read_bytes().count(b"\n") == len(specs) - 1
    assert not (tmp_path / "results.csv").exists()


def test_a_second_result_of_a_trial_is_not_taken(tmp_path, config, specs):
    with ResultsFolder.open(tmp_path, config, ExecutionConfig(), specs) as folder:
        folder.append(record(specs[0]))
        with pytest.raises(ValueError, match="already has a result"):
            folder.append(record(specs[0]))
        with pytest.raises(ValueError, match="7 trials have no result"):
            folder.complete()


def test_the_table_holds_every_value_to_the_last_bit(tmp_path, config, specs):
    run(tmp_path, config, specs, Scripted())
    table = pyarrow.parquet.read_table(tmp_path / "results.parquet")
    rows = table.to_pylist()
    with (tmp_path / "results.csv").open() as file:
        texts = list(csv.DictReader(file))
    for spec, row, text in zip(specs, rows, texts, strict=True):
        result = finished(spec)
        for name, value in (vars(result.scores) | vars(result.measures)).items():
            assert row[name] == value
            if isinstance(value, float):
                assert float(text[name]) == value
    types = {field.name: str(field.type) for field in table.schema}
    assert types["world"] == types["simulator_seed"] == "int64"
    assert types["traversal_time_s"] == types["min_clearance_m"] == "double"
    assert (types["success"], types["outcome"]) == ("bool", "string")
    assert len(set(table.column_names)) == len(table.column_names)


class Shares(DirectWork):
    """Hands out trials by planner."""

    def jobs(self, trials):
        of_planners = {}
        for spec in trials:
            of_planners.setdefault(spec.planner, []).append(spec)
        return [Job(name, tuple(part)) for name, part in of_planners.items()]


class PartByPart(Scripted):
    """Reports the trials of a job one by one; `fate` may lose it instead."""

    def wait(self, limit_s):
        key = next(iter(self.out))
        job = self.out.pop(key)
        reports = []
        for spec in job.trials:
            name = spec.trial_id
            self.attempts[name] += 1
            done = PartialResult(key, "scripted", record(spec), ENDED_AT)
            part = self.fate(name, self.attempts[name], done)
            reports.append(replace(part, key=key))
            if isinstance(part, JobLoss):
                return reports
        return [*reports, JobResult(key, "scripted", None, "")]


def test_a_job_of_several_trials_resumes_at_the_lost_one(tmp_path, config, specs):
    second, last = (spec.trial_id for spec in (specs[2], specs[-2]))
    fate = lost_if(lambda key, attempt: key == last or (key == second and attempt < 3))
    engine = PartByPart(slots=1, fate=fate)
    execution = ExecutionConfig(attempts=3)
    work = Shares(BagStore(tmp_path))
    with ResultsFolder.open(tmp_path, config, execution, specs) as folder:
        events = list(run_trials(folder, folder.remaining, engine, execution, work))
        results = {result.trial_id: result for result in folder.complete()}
    losses = [event.trial_id for event in events if isinstance(event, TrialLoss)]
    assert losses == [second, second, last, last, last]
    assert set(engine.attempts.values()) == {1, 3}
    assert results[second].outcome == finished(specs[2]).outcome
    assert results[last].outcome == Outcome.PLANNER_DIED
    assert results[second].wall_clock.attempts == 3
    assert results[specs[0].trial_id].wall_clock.attempts == 1


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit, StoreError])
def test_a_trial_that_breaks_a_run_off_has_had_an_attempt(tmp_path, config, specs, end):
    """Else a planner that is about to lose would have it again without a trace."""

    def break_off(key, attempt, result):
        if key == specs[1].trial_id:
            raise end
        return result

    with pytest.raises(end):
        run(tmp_path, config, specs, Scripted(slots=1, fate=break_off))
    run(tmp_path, config, specs, Scripted(slots=1))
    rows = {row.trial_id: row for row in read_results(tmp_path)}
    attempts = [rows[spec.trial_id].wall_clock.attempts for spec in specs]
    assert attempts == [1, 2, 1, 1, 1, 1, 1, 1]


def test_a_trial_without_a_score_has_had_an_attempt(tmp_path, config, specs):
    def fail(key, attempt, done):
        row = replace(done.result.result, fault="environment")
        return replace(done, result=replace(done.result, result=row))

    run(tmp_path, config, specs, Scripted(fate=fail))
    run(tmp_path, config, specs, Scripted())
    assert {row.wall_clock.attempts for row in read_results(tmp_path)} == {2}


def test_a_trial_whose_folder_was_moved_has_had_an_attempt(tmp_path, config, specs):
    out = tmp_path / "out"

    def move(key, attempt, result):
        out.rename(tmp_path / "away")
        shutil.copytree(tmp_path / "away", out)
        return result

    with refused("which was moved", StoreError):
        run(out, config, specs, Scripted(slots=1, fate=move))
    (note,) = (out / "losses").iterdir()
    assert "interrupted: StoreError" in note.read_text()


def test_a_trial_has_had_an_attempt_even_if_nothing_can_be_written(
    tmp_path, config, specs
):
    no_limit = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(key, attempt, result):
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, no_limit[1]))
        return result

    try:
        with refused("cannot be written: File too large", StoreError):
            run(tmp_path, config, specs, Scripted(slots=1, fate=fill))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, no_limit)
    run(tmp_path, config, specs, Scripted())
    attempts = [row.wall_clock.attempts for row in read_results(tmp_path)]
    assert sorted(attempts) == [1] * (len(specs) - 1) + [2]
    assert len(list((tmp_path / "losses").iterdir())) == 1
