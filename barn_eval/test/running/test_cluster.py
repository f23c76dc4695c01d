"""A two-node Ray cluster on this machine whose workers are killed."""

import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import campaign_runs
import campaign_work
import pytest
import waiting
from campaign_work import Deeds, all_reports, echoes, failed_keys, report_of, signatures
from refusals import refused
from waiting import until

from barn_eval.ros.work import run_request
from barn_eval.running.pool import JobLoss, JobRefusal, JobResult
from barn_eval.running.ray_pool import RayPool
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import read_request


@pytest.fixture(scope="module")
def cluster():
    ray = pytest.importorskip("ray", reason="Ray, an optional extra, is not installed")
    Cluster = pytest.importorskip("ray.cluster_utils").Cluster
    for module in (campaign_work, waiting):
        ray.cloudpickle.register_pickle_by_value(module)
    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    yield cluster
    cluster.shutdown()


@pytest.fixture
def engine(cluster):
    with closing(
        RayPool(Deeds(), workers=0, trial_limit_s=600.0, address=cluster.address)
    ) as engine:
        yield engine


def test_jobs_go_to_both_nodes(engine, tmp_path):
    assert engine.slots == 2
    meeting = ("meet", (tmp_path / "list", 2))
    reports = all_reports(engine, dict.fromkeys("ab", meeting))
    assert failed_keys(reports) == []
    assert len({report.result for report in reports.values()}) == 2, (
        "one raylet is the parent of all workers"
    )


def test_a_killed_worker_loses_its_own_job_only(engine, tmp_path):
    killed = {"killed": ("die", signal.SIGKILL), "after": ("echo", "after")}
    jobs = echoes(8) | killed
    reports = all_reports(engine, jobs)
    assert reports["killed"].reason == "its worker was lost: WorkerCrashedError"
    assert failed_keys(reports) == ["killed"]


def test_failures_and_mistakes_are_told_apart(engine):
    jobs = {"a": ("fail", "no luck"), "b": ("refuse", "no such preset")}
    reports = all_reports(engine, jobs | {"c": ("whoami", 0)})
    assert reports["a"].reason == "ValueError: no luck"
    assert "in fail" in reports["a"].traceback
    assert reports["b"] == JobRefusal("b", reports["b"].worker, "no such preset")
    assert reports["c"].result[2] == "1", "workers must not start threads of their own"


def test_a_job_over_its_time_is_lost(cluster, tmp_path):
    with closing(
        RayPool(Deeds(), workers=2, trial_limit_s=12.0, address=cluster.address)
    ) as engine:
        lost = report_of(engine, "meet", (tmp_path / "list", 2))
        # a worker starts within the limit of a job, which a busy machine may exceed
        while not isinstance(report_of(engine, "echo", 1), JobResult):
            pass
    assert lost.reason == "no result within 12 s of wall-clock time"


def test_a_joining_node_gets_jobs_which_its_exit_loses(engine, cluster, tmp_path):
    meeting = tmp_path / "list"
    reports = []

    def reported(count):
        reports.extend(engine.wait(1.0))
        return len(reports) >= count

    node = cluster.add_node(num_cpus=1)
    until(lambda: engine.slots == 3)
    for key in "abc":
        engine.submit(key, ("meet", (meeting, 4)))
    until(lambda: signatures(meeting) == 3)
    cluster.remove_node(node, allow_graceful=False)
    until(lambda: reported(1))
    assert [type(report) for report in reports] == [JobLoss]
    until(lambda: engine.slots == 2)
    with meeting.open("a") as file:
        file.write("go\n")
    until(lambda: reported(3))
    assert [type(report) for report in reports] == [JobLoss, JobResult, JobResult]


def test_a_run_that_loses_a_node_gives_the_same_bytes(cluster, tmp_path):
    choice = {"planners": "[gap]", "repetitions": 10}
    file = campaign_runs.write_campaign(tmp_path, "moving", **choice)
    local, distributed = tmp_path / "local", tmp_path / "ray"
    inline = read_request(file, {"out": local, "engine": "inline"})
    run_request(inline, Reporter())
    node = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()

    def lose():
        until(lambda: campaign_runs.rows(distributed) >= 5)
        cluster.remove_node(node, allow_graceful=False)

    with ThreadPoolExecutor() as pool:
        losing = pool.submit(lose)
        options = {"engine": "ray", "address": cluster.address, "out": distributed}
        results = run_request(read_request(file, options), Reporter())
        losing.result()
    assert campaign_runs.tables(distributed) == campaign_runs.tables(local)
    assert max(result.wall_clock.attempts for result in results) <= 2
    assert len({result.wall_clock.worker for result in results}) >= 2


def test_an_address_that_leads_nowhere_is_named(cluster):
    with refused(r"engine ray: cannot reach 127\.0\.0\.1:1: "):
        RayPool(Deeds(), workers=1, trial_limit_s=5.0, address="127.0.0.1:1")


def test_missing_ray_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with refused("engine ray needs Ray, which is not installed"):
        RayPool(Deeds(), workers=1, trial_limit_s=5.0)
