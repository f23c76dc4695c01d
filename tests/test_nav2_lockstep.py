"""Nav2's own plugins in lockstep, where examples/nav2/lockstep and Nav2 are built.

The host is looked for in AMENT_PREFIX_PATH; NAV2_LOCKSTEP may name a command that runs
it in an environment of its own.
"""

import os
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from repository import EXAMPLES
from ros_runs import make_plan, nothing_left, run  # noqa: F401 (a fixture)

from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Outcome
from barn_eval.trials.ros_config import RosConfig

PARAMETERS = EXAMPLES / "nav2/params"
PREFIXES = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
BUILT = [
    str(path)
    for path in (Path(p, "lib/nav2_lockstep/nav2_lockstep") for p in PREFIXES)
    if path.is_file()
]
HOST = os.environ.get("NAV2_LOCKSTEP") or next(map(shlex.quote, BUILT), "")

if not HOST:
    pytest.skip(
        "examples/nav2/lockstep is not built, or Nav2 is not installed",
        allow_module_level=True,
    )


def host(controller):
    files = [
        f"--params-file {shlex.quote(str(PARAMETERS / name))}.yaml"
        for name in ("common", "mapless", controller)
    ]
    return " ".join([HOST, "--ros-args", *files])


@pytest.mark.parametrize("controller", ["rpp", "dwb"])
def test_the_same_seed_gives_the_same_drive(tmp_path, controller):
    ros = RosConfig(restart_planner="each_trial", command_wait_s=60.0)
    limits = replace(CHALLENGE, name="short", limit_s=10.0, timeout_time_s=10.0)
    plan = make_plan(limits, ros, "nav2", host(controller), worlds="0-1")
    runs = []
    for turn in ("once", "again"):
        results = run(tmp_path / turn, plan)
        assert [result.wall_clock.missed_cycles for result in results] == [0, 0]
        assert all(
            result.outcome in (Outcome.TIMEOUT, Outcome.COLLISION, Outcome.SUCCESS)
            for result in results
        )
        sent = [commands(bag) for bag in sorted((tmp_path / turn).glob("bags/*"))]
        assert all(result.measures.driven_m > 1.0 for result in results)
        runs.append(([result.repeatable() for result in results], sent))
    assert runs[0] == runs[1]


def commands(bag):
    """Return the serialized commands of a bag.

    All else is not decoded, of which plugins may publish much.
    """
    (path,) = bag.glob("*.mcap")
    with path.open("rb") as file:
        return [
            message.data
            for _, _, message in make_reader(file).iter_messages(topics=["/cmd_vel"])
        ]
