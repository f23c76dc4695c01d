"""Runs through several routes of one map: each is a world, ranked by efficiency, with time enough."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from barn_eval.running.dry_run import estimate_run
from barn_eval.running.request import read_request
from barn_eval.running.run import check_limits
from barn_eval.trials.protocol import CHALLENGE, load_protocol
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import OccupancyMap
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.map_server import write_map

COURSES = [(1.0, 1.0, 0.0, 7.0, 1.0), (1.0, 3.0, 0.0, 7.0, 3.0)]
SLOW = {
    "planners": "dwa",
    "settings": {"dwa.max_speed_mps": 0.05, "dwa.min_speed_mps": 0.01},
}


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """A map of 8 x 4 m with a wall between two rooms, open at both ends."""
    cells = np.zeros((80, 160), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[30:50, 80] = 100
    path = tmp_path_factory.mktemp("rooms") / "rooms.yaml"
    write_map(OccupancyMap(cells, 0.05, 0.0, 0.0), path)
    return path


def request_of(rooms, tmp_path, **options):
    options = {"dataset": rooms, "planners": "gap", "out": tmp_path / "out"} | options
    return read_request(None, options)


@pytest.fixture
def spec(rooms, tmp_path):
    """The only trial on the first course."""
    (only,) = request_of(rooms, tmp_path, course=COURSES[:1]).trials()
    return only


def protocol_of(tmp_path, text):
    path = tmp_path / "own.yaml"
    path.write_text(f"schema_version: 1\nbase: challenge\nname: own\n{text}\n")
    return path


def test_each_drawn_route_is_a_world(rooms, tmp_path):
    trials = request_of(rooms, tmp_path, routes=5).trials()
    assert [spec.world_number for spec in trials] == [0, 1, 2, 3, 4]
    assert len({spec.world.checksum for spec in trials}) == 5
    assert trials[2].world.name == "rooms route 2"
    other = request_of(rooms, tmp_path, routes=5, seed=3).trials()
    assert other[0].world.checksum != trials[0].world.checksum


def test_worlds_select_among_routes(rooms, tmp_path):
    request = request_of(rooms, tmp_path, routes=5, worlds="1,3")
    assert [spec.world_number for spec in request.trials()] == [1, 3]
    assert request.dataset.world_numbers == (0, 1, 2, 3, 4)


def test_each_of_several_courses_is_a_world(spec, rooms, tmp_path):
    trials = request_of(rooms, tmp_path, course=COURSES).trials()
    starts = [trial.course.start.position for trial in trials]
    assert starts == [(1.0, 1.0), (1.0, 3.0)]
    assert spec.world.name == "rooms"


def test_routes_of_a_map_are_worlds_by_name(rooms, tmp_path):
    path = tmp_path / "rooms.yaml"
    routes = "routes:\n  out: {start: [1, 1, 0], goal: [7, 1]}\n  back: {start: [7, 3, 3.14], goal: [1, 3]}\n"
    path.write_text(rooms.read_text() + routes)
    shutil.copy(rooms.with_suffix(".pgm"), tmp_path)
    trials = request_of(path, tmp_path).trials()
    names = [(spec.world_number, spec.world.name) for spec in trials]
    assert names == [(0, "rooms route out"), (1, "rooms route back")]
    assert [spec.course.start.x for spec in trials] == [1.0, 7.0]
    # In a folder, each map has its own routes or one course.
    folder = tmp_path / "maps"
    folder.mkdir()
    for file in (path, *rooms.parent.glob("rooms.*")):
        name = "a.yaml" if file == path else file.name
        shutil.copy(file, folder / name)
    worlds = open_dataset(folder)
    names = [worlds.load(number).name for number in worlds.world_numbers]
    assert names == ["a route out", "a route back", "rooms"]
    # What the command line names takes the place of routes in the file.
    (trial,) = request_of(path, tmp_path, course=COURSES[:1]).trials()
    assert (trial.world.name, trial.course.goal.x) == ("rooms", 7.0)
    assert len(request_of(path, tmp_path, routes=3).trials()) == 3


@pytest.mark.parametrize(
    "options, message",
    [
        ({"routes": 2000}, "routes must be from 0 to 1000, got 2000"),
        ({"routes": "many"}, "routes must be a whole number"),
        ({"course": [(1.0, 1.0), (2.0, 2.0)]}, "course must be x, y, yaw"),
        ({"course": [COURSES[0], "1,2"]}, "course"),
        ({"course": [COURSES[0], (1.0, 9.0, 0.0, 7.0, 1.0)]}, "off the map"),
    ],
)
def test_routes_that_make_no_sense_are_refused(rooms, tmp_path, options, message):
    with refused(message, BarnError):
        request_of(rooms, tmp_path, **options)


def test_routes_are_ranked_by_efficiency_and_barns_worlds_as_before(rooms, tmp_path):
    for options, metric in (
        ({"routes": 1}, "efficiency"),
        ({"dataset": "barn300", "worlds": "0"}, "challenge"),
        (
            {"dataset": "barn300", "worlds": "0", "robot": "turtlebot3_burger"},
            "efficiency",
        ),
        ({"routes": 1, "protocol": "known_map"}, "efficiency"),
    ):
        (spec,) = request_of(rooms, tmp_path, **options).trials()
        assert spec.metric == metric
    # Nobody knows how fast a planner is that was started by hand, nor its bound.
    (spec,) = request_of(rooms, tmp_path, routes=1).trials()
    unknown = replace(spec, declared_mps=0.0, planner_config="")
    assert unknown.metric == "challenge"


def test_the_limit_follows_from_the_path(spec, rooms, tmp_path):
    (barn,) = request_of(rooms, tmp_path, dataset="barn300", worlds="0").trials()
    assert barn.scaled_protocol is CHALLENGE
    assert spec.scaled_protocol == CHALLENGE  # 100 s are enough for 6 m
    long = replace(spec, world=replace(spec.world, resolution_m=0.5))
    protocol = long.scaled_protocol
    # 0.5 m/s is a quarter of the reference speed.
    expected_s = 3.0 * math.ceil(long.world.path_length_m / 0.5)
    times_s = (protocol.limit_s, protocol.timeout_time_s, protocol.failure_time_s)
    assert times_s == pytest.approx((expected_s, expected_s, expected_s))


def test_a_limit_that_somebody_chose_is_kept(rooms, tmp_path):
    protocol = load_protocol(str(protocol_of(tmp_path, "limit_s: 20.0")))
    assert protocol.own_limit == 0.0
    trials = request_of(rooms, tmp_path, protocol=protocol, routes=3).trials()
    assert {spec.scaled_protocol.limit_s for spec in trials} == {20.0}


def test_a_limit_that_cannot_be_met_is_refused(rooms, tmp_path):
    protocol = protocol_of(tmp_path, "limit_s: 11.0")
    trials = request_of(rooms, tmp_path, protocol=protocol, course=COURSES[:1], **SLOW)
    with refused("dwa in rooms needs at least .* s at 0.05 m/s, above limit_s = 11 s"):
        check_limits(trials.trials())
    barn = request_of(rooms, tmp_path, dataset="barn300", worlds="0", **SLOW)
    with refused("above limit_s = 100 s; set a longer limit in a protocol file"):
        estimate_run(barn)


def test_a_limit_that_can_hardly_be_met_is_warned_of(spec):
    assert check_limits([spec]) == ""
    for share, warns in ((0.85, False), (0.95, True)):
        limit_s = spec.least_time_s / share
        protocol = replace(CHALLENGE, name="own", limit_s=limit_s, own_limit=0.0)
        tight = replace(spec, protocol=protocol)
        assert ("at least 90% of the limit" in check_limits([tight])) == warns


def test_routes_end_in_a_verdict_and_resume(rooms, tmp_path, succeed):
    out = tmp_path / "out"
    command = ["run", "--dataset", rooms, "--course", "1,1,0:4,0.8", "--course"]
    command += ["1,3,0:4,3.2", "--planners", "gap,dwa", "--out", out, "--execution"]
    command += ["engine=inline"]
    output = succeed(*command)
    assert "ranked by efficiency" in output
    assert "efficiency" in output.split("spread")[0]
    rows = (out / "results.jsonl").read_bytes()
    assert succeed(*command) == output
    assert (out / "results.jsonl").read_bytes() == rows
