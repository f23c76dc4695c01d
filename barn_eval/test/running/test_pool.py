"""Local workers that are killed, hang, fail and are orphaned."""

import os
import re
import signal
import subprocess
import sys
import textwrap
from contextlib import closing
from pathlib import Path

import pytest
from campaign_runs import stop
from campaign_work import Deeds, all_reports, echoes, failed_keys, report_of
from waiting import alive, until

from barn_eval.running import local_pool as local
from barn_eval.running.local_pool import LocalPool
from barn_eval.running.pool import JobLoss, JobRefusal, JobResult, PartialResult


@pytest.fixture
def engine():
    with closing(LocalPool(Deeds(), workers=2, trial_limit_s=600.0)) as engine:
        yield engine


def started(engine):
    """Wait until a worker does a job within the limit of its engine, for which a busy
    machine may need several.
    """
    while not isinstance(report_of(engine, "echo", 1), JobResult):
        pass


def test_every_job_is_reported_once_and_workers_are_kept(engine):
    reports = all_reports(engine, echoes(40))
    assert [reports[str(n)].result for n in range(40)] == list(range(40))
    reports = all_reports(engine, dict.fromkeys("abcdefghij", ("whoami", None)))
    pids, jobs, _ = zip(*(report.result for report in reports.values()), strict=True)
    assert len(set(pids)) <= 2
    assert os.getpid() not in pids
    assert max(jobs) > 1


def test_a_stopped_worker_is_the_machines_fault(monkeypatch):
    monkeypatch.setattr(local, "GRACE_S", 0.5)
    with closing(LocalPool(Deeds(), workers=1, trial_limit_s=2.0)) as engine:
        started(engine)
        report = report_of(engine, "die", signal.SIGSTOP)
        assert report.is_stall and not report.is_overtime
        assert report.reason.endswith("as the machine stood still")
        started(engine)


def test_environment_of_workers_does_not_leak(engine, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    _, _, threads = report_of(engine, "whoami", None).result
    assert threads == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


@pytest.mark.parametrize(
    "deed, argument, reason",
    [
        ("die", signal.SIGKILL, "its worker process was killed by SIGKILL"),
        ("die", signal.SIGSEGV, "its worker process was killed by SIGSEGV"),
        ("leave", 3, "its worker process ended with exit code 3"),
        ("fail", "no luck", "ValueError: no luck"),
    ],
)
def test_a_worker_that_dies_loses_its_own_job_only(engine, deed, argument, reason):
    jobs = echoes(12) | {"lost": (deed, argument), "after": ("echo", "after")}
    reports = all_reports(engine, jobs)
    assert reports["lost"].reason == reason
    assert failed_keys(reports) == ["lost"]


def test_failures_and_mistakes_are_told_apart(engine):
    reports = all_reports(
        engine, {"a": ("fail", "no luck"), "b": ("refuse", "no such preset")}
    )
    assert "in fail" in reports["a"].traceback
    assert reports["b"] == JobRefusal("b", reports["b"].worker, "no such preset")


def test_a_result_that_cannot_be_sent_is_a_loss(engine):
    reports = all_reports(
        engine, {"a": ("unpicklable", 1), "b": ("huge", 5_000_000), "c": ("echo", 1)}
    )
    assert isinstance(reports["a"], JobLoss)
    assert len(reports["b"].result) == 5_000_000
    assert reports["c"].result == 1


def test_a_job_over_its_time_is_lost_even_if_it_resists(monkeypatch, tmp_path):
    monkeypatch.setattr(local, "GRACE_S", 0.5)
    work = Deeds(str(tmp_path / "log"))
    jobs = {"a": ("sleep", 3600), "b": ("ignore_term", 3600)}
    with closing(LocalPool(work, workers=2, trial_limit_s=4.0)) as engine:
        reports = all_reports(engine, jobs)
        started(engine)
    for key in "ab":
        assert reports[key].reason.startswith("no result within 4 s of wall-clock time")


def reports_of_one(engine, job):
    engine.submit("a", job)
    reports = []
    while not reports or isinstance(reports[-1], PartialResult):
        reports += engine.wait(5.0)
    return reports


def test_parts_of_a_job_come_before_its_end(engine):
    *parts, last = reports_of_one(engine, ("parts", 5))
    assert [part.result for part in parts] == [0, 1, 2, 3, 4]
    assert isinstance(last, JobResult)
    *parts, last = reports_of_one(engine, ("parts_then_die", 3))
    assert [part.result for part in parts] == [0, 1, 2]
    assert isinstance(last, JobLoss)


def test_the_time_limit_is_one_for_each_part():
    with closing(LocalPool(Deeds(), workers=1, trial_limit_s=4.0)) as engine:
        started(engine)
        assert isinstance(reports_of_one(engine, ("slow_parts", 1.5))[-1], JobResult)


def test_an_idle_worker_that_was_killed_costs_nothing(engine):
    reports = all_reports(engine, dict.fromkeys("abcdef", ("whoami", 0)))
    for pid in {report.result[0] for report in reports.values()}:
        os.kill(pid, signal.SIGKILL)
        # until its last thread has let go of the pipe
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    assert failed_keys(all_reports(engine, echoes(6))) == []


def pids_of(log, word):
    """Return the workers of which a log says that they have begun or closed."""
    text = log.read_text() if log.exists() else ""
    return [int(pid) for pid in re.findall(rf"(?m)^{word} (\d+)$", text)]


def test_close_ends_idle_and_busy_workers_and_lets_them_clean_up(tmp_path):
    log = tmp_path / "log"
    engine = LocalPool(Deeds(str(log)), workers=2, trial_limit_s=600.0)
    engine.submit("a", ("sleep", 3600))
    engine.submit("b", ("whoami", None))
    (report,) = engine.wait(600.0)
    until(lambda: pids_of(log, "started"))
    engine.close()
    (busy,) = pids_of(log, "started")
    assert sorted(pids_of(log, "closed")) == sorted([busy, report.result[0]])
    assert not any(map(alive, pids_of(log, "closed")))


def test_a_worker_ended_amid_a_construction_ends_quietly(tmp_path, capfd):
    log = tmp_path / "log"
    engine = LocalPool(Deeds(str(log)), workers=1, trial_limit_s=600.0)
    engine.submit("a", ("make", 3600))
    until(lambda: pids_of(log, "started"))
    engine.close()
    assert pids_of(log, "closed")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_no_worker_outlives_the_campaign(tmp_path, number):
    script = textwrap.dedent("""
        import sys
        from contextlib import closing
        from campaign_work import Deeds
        from barn_eval.running.local_pool import LocalPool
        with closing(LocalPool(Deeds(sys.argv[1]), workers=2, trial_limit_s=600.0)) as engine:
            engine.submit("a", ("sleep", 3600))
            engine.submit("b", ("sleep", 3600))
            engine.wait(600.0)
    """)
    log = tmp_path / "log"
    command = [sys.executable, "-c", script, str(log)]
    folder = Path(__file__).parents[1]
    with subprocess.Popen(command, cwd=folder, start_new_session=True) as parent:
        until(lambda: len(pids_of(log, "started")) == 2)
        pids = pids_of(log, "started")
        stop(parent, number)
        parent.wait(600.0)
    until(lambda: not any(map(alive, pids)))
    until(lambda: len(pids_of(log, "closed")) == 2)
    assert sorted(pids_of(log, "closed")) == sorted(pids)
