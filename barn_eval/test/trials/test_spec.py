"""Tasks and protocols that cannot be confused.

Fingerprints, built-in names, changed files, and the order of trials.
"""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from reproduce_work import write_invented

from barn_eval.analysis.compare import compare_folders
from barn_eval.results.folder import order_trials_fairly
from barn_eval.ros.supervision import nodes
from barn_eval.trials.protocol import (
    CHALLENGE,
    KNOWN_MAP,
    PAPER_2020,
    PROTOCOLS,
    check_protocol_name,
)
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_worlds.base.errors import BarnError


def experiment(protocol=CHALLENGE, worlds="0,9", **changes):
    simulator = simulator_config(protocol, changes.pop("simulator", {}))
    return RunConfig(worlds=worlds, protocol=protocol, simulator=simulator, **changes)


def test_eight_protocols_are_offered():
    names = [
        "challenge",
        "challenge_2022",
        "challenge_2022_03",
        "dynabarn",
        "dynabarn_clear",
        "dynabarn_clock",
        "known_map",
        "paper2020",
    ]
    assert sorted(PROTOCOLS) == names
    assert (KNOWN_MAP.map_given, KNOWN_MAP.historical_map) == (True, False)
    assert (KNOWN_MAP.collision_ends_trial, KNOWN_MAP.movable_obstacles) == (
        True,
        False,
    )
    assert simulator_config(KNOWN_MAP).localisation.mode == "amcl"
    assert (CHALLENGE.metric, PAPER_2020.metric) == (
        "challenge",
        "normalised_time_s_per_m",
    )


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_built_in_name_stands_for_the_built_in_rules(name):
    check_protocol_name(PROTOCOLS[name])
    with refused(
        rf"name: '{name}' is built in with another goal_distance_m; choose a different"
    ):
        check_protocol_name(replace(PROTOCOLS[name], goal_distance_m=4.0))


def test_every_change_of_the_task_changes_its_fingerprint():
    base = experiment().trials()[0].task
    variants = [
        experiment(replace(CHALLENGE, name="renamed")),
        experiment(replace(CHALLENGE, name="longer", limit_s=101.0)),
        experiment(simulator={"localisation.mode": "amcl"}),
        experiment(simulator={"lidar.noise_m": 0.02}),
        experiment(KNOWN_MAP),
    ]
    fingerprints = [variant.trials()[0].task for variant in variants]
    assert len({base, *fingerprints}) == len(variants) + 1
    assert {
        spec.task for spec in experiment(worlds="0-3", seed=7, repetitions=2).trials()
    } == {base}


def test_a_planner_is_told_by_what_it_is_set_to():
    def configured(choice):
        return [
            spec.planner_config
            for spec in experiment(worlds="0", planners=(choice,)).trials()
        ]

    faster = PlannerChoice("dwa", overrides={"dwa.max_speed_mps": 0.4})
    variants = [
        PlannerChoice("dwa"),
        faster,
        PlannerChoice("dwa", preset="fast_dwa"),
        PlannerChoice("eband"),
    ]
    fingerprints = [configured(choice)[0] for choice in variants]
    assert len(set(fingerprints)) == 4
    assert configured(PlannerChoice("dwa", preset="challenge")) == fingerprints[:1]


def test_the_planner_knows_where_the_lidar_is():
    (spec,) = experiment(PAPER_2020, "0", planners=(PlannerChoice("gap"),)).trials()
    assert spec.overrides == {"lidar_x_m": 0.12}
    (spec,) = experiment(PAPER_2020, "0").trials()
    assert spec.overrides == {}
    with refused(
        r"planner 'gap': lidar_x_m is 0\.3, but the lidar is mounted at 0\.055 m"
    ):
        experiment(
            planners=(PlannerChoice("gap", overrides={"lidar_x_m": 0.3}),)
        ).trials()


def test_a_planners_node_is_told_the_same_as_a_direct_one():
    choice = PlannerChoice("gap", overrides={"max_speed_mps": 0.4})
    config = experiment(PAPER_2020, "0", planners=(choice,), mode="ros")
    (spec,) = config.trials()
    parameters = nodes.planner(choice, config).parameters
    assert [parameters[name] for name in ("planner", "preset", "use_map")] == [
        "gap",
        spec.preset,
        True,
    ]
    assert spec.overrides == {"max_speed_mps": 0.4, "lidar_x_m": 0.12}
    assert spec.overrides.items() <= parameters.items()


def test_different_tasks_are_not_compared_and_the_key_is_named(tmp_path):
    write_invented(tmp_path / "a", experiment())
    write_invented(tmp_path / "b", experiment(simulator={"localisation.mode": "amcl"}))
    with refused(
        r"simulator\.localisation\.mode is 'exact' in .*a, 'amcl' in .*b", BarnError
    ):
        compare_folders(tmp_path / "a", tmp_path / "b")
    write_invented(tmp_path / "c", experiment())
    assert compare_folders(tmp_path / "a", tmp_path / "c")[0].trials_a == 2


def test_every_beginning_of_the_trials_is_like_the_whole():
    specs = experiment(
        worlds="0-63",
        repetitions=2,
        planners=(PlannerChoice("dwa"), PlannerChoice("eband")),
    ).trials()
    order = order_trials_fairly(specs)
    assert sorted(spec.trial_id for spec in order) == sorted(
        spec.trial_id for spec in specs
    )
    assert [spec.planner for spec in order[:4]] == ["dwa", "eband"] * 2
    assert [spec.repetition for spec in order] == [0] * 128 + [1] * 128
    for count in (8, 16, 32, 64):
        worlds = {spec.world_number for spec in order[:count]}
        assert sorted(worlds) == list(range(0, 64, 128 // count))
    assert order_trials_fairly(specs[:2]) == specs[:2]


def test_the_map_that_is_given_holds_start_and_goal():
    spec, paper = (
        experiment(protocol, "100").trials()[0] for protocol in (KNOWN_MAP, PAPER_2020)
    )
    protocol_map = spec.map
    world_map = spec.world.occupancy_map()
    rows, cols = world_map.data.shape
    assert np.array_equal(protocol_map.data[:rows, :cols], world_map.data)
    assert not protocol_map.data[rows:].any()
    for pose in (spec.course.start, spec.course.goal):
        assert (
            0
            <= (pose.y - protocol_map.origin_y) / protocol_map.resolution
            < protocol_map.data.shape[0] - 1
        )
    assert np.array_equal(
        paper.map.data, paper.world.occupancy_map(historical=True).data
    )
