"""The catalog of measures, and the one color and spelling of each planner."""

from dataclasses import replace

import numpy as np
from refusals import refused
from results.test_rows import result

from barn_eval.analysis.compare import compare
from barn_eval.analysis.leaderboard import RANKINGS
from barn_eval.analysis.measures import (
    COMPARED,
    DRIVEN,
    MEASURES,
    MOVING,
    SCORED,
    clearance_measure,
    ranking_measure,
    require_measures,
    with_moving_measures,
)
from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.analysis.summary import summarize, summarize_run
from barn_eval.analysis.tables import summary_table, trials_table
from barn_eval.analysis.text_table import count_noun
from barn_eval.results.rows import results_table, timing_table
from barn_eval.trials.encounters import Encounters
from barn_eval.trials.result import WallClock
from barn_eval.trials.trajectory import NEAR_CONTACT_M
from barn_metrics.bootstrap import Interval
from barn_worlds.drawing.palette import PLANNERS


def moved():
    """Return a result of a world in which obstacles move."""
    return replace(
        result(3),
        motion=Encounters(7.0, 0.25, 1.5, 2.0, 1.25, 2.5, "walker", 0.5, 2.0, 0.25),
    )


def test_keys_are_columns_of_the_tables_and_values_are_theirs():
    moving_result = moved()
    columns = {
        **timing_table([moving_result]).to_pylist()[0],
        **results_table([moving_result]).to_pylist()[0],
    }
    columns["path_ratio"] = columns["driven_m"] / columns["path_length_m"]
    assert [measure.key for measure in MEASURES.values()] == list(MEASURES)
    for key, measure in MEASURES.items():
        np.testing.assert_equal(
            measure.raw_values([moving_result]), np.float64(columns[key])
        )


LARGER = """
success challenge challenge_2022 efficiency min_clearance_m mean_clearance_m
moving_clearance_m time_to_collision_s
"""
NEITHER = """
optimal_time_s least_time_s mean_speed_mps recoveries real_time_factor waited_s
not_at_fault
"""


def test_a_better_robot_is_faster_safer_and_smoother():
    sides = {
        side: {key for key, measure in MEASURES.items() if measure.better == side}
        for side in ("larger", "smaller", "")
    }
    assert sides["larger"] == set(LARGER.split())
    assert sides[""] == set(NEITHER.split())
    assert COMPARED[-3:] == ("rotation_rad", "compute_p50_ms", "compute_p95_ms")
    # There is no better one by these.
    assert not sides[""] & {*COMPARED, *RANKINGS.values()}
    assert len(sides["smaller"]) == len(MEASURES) - 15


def test_what_a_robot_drives_counts_where_it_arrives():
    of_successes = {key for key, measure in MEASURES.items() if measure.successes_only}
    of_arrivals = {"traversal_time_s", "driven_m", "path_ratio", "rotation_rad"}
    assert of_successes == of_arrivals | {"path_over_straight", "time_over_straight"}


WRITTEN = """
success [%]: 100.0
time [s]: 10.10
time as counted [s]: 10.10
time per meter as counted [s/m]: 2.020
optimal time [s]: 3.00
challenge metric (of 0.5): 0.290
challenge metric of 2022 (of 0.25): 0.250
efficiency [%]: 50.0
least time possible [s]: 5.05
driven length [m]: 5.500
driven by path length: 1.100
time before the clock [s]: 1.90
hit at rest [%]: 0.0
hit without fault [%]: 0.0
mean speed [m/s]: 0.500
smallest clearance [m]: 0.100
mean clearance [m]: 0.300
time in contact [s]: 0.000
rms jerk [m/s3]: 0.20
time within 0.1 m of obstacles [s]: 0.40
rms angular jerk [rad/s3]: 7.5
total variation of speed commands [m/s]: 3.00
total variation of turn commands [rad/s]: 6.00
rms step of speed commands [m/s]: 0.0100
rms step of turn commands [rad/s]: 0.0200
mean distance from the plan [m]: 0.150
rotation [rad]: 1.00
recoveries: 2.00
unanswered cycles: 0.00
missed cycles: 4.00
compute time per cycle, p50 [ms]: 1.11
compute time per cycle, p95 [ms]: 2.22
compute time per cycle, max [ms]: 3.33
times real time: 31.4
smallest clearance to what moves [m]: 0.250
shortest time to collision [s]: 1.50
time within 0.5 m of what moves [s]: 2.00
driven by straight length: 1.250
time by that of the straight run: 2.500
own speed when hit [m/s]: 0.50
closing speed when hit [m/s]: 2.00
own share of the closing speed [%]: 25.0
"""


def test_measures_are_written_with_units_and_digits():
    moving_result = moved()
    timed = replace(
        moving_result,
        recoveries=2,
        wall_clock=WallClock(12.0, 31.416, 1.111, 2.222, 3.333, missed_cycles=4),
    )
    written = {
        f"{measure.trial_heading}: {measure.number(measure.raw_values([timed])[0])}"
        for measure in MEASURES.values()
    }
    assert written == set(WRITTEN.strip().splitlines())


def test_a_title_says_that_only_successes_are_in():
    assert MEASURES["driven_m"].heading == "driven length of successes [m]"
    assert MEASURES["contact_s"].heading == "time in contact [s]"


def test_a_unit_follows_a_value():
    assert [MEASURES[key].after for key in ("success", "driven_m", "recoveries")] == [
        "%",
        " m",
        "",
    ]


def test_the_best_is_the_highest_there_can_be_or_no_time():
    assert [
        MEASURES[key].best for key in ("success", "challenge", "scored_time_s")
    ] == [1.0, 0.5, 0.0]


def test_failures_count_nothing_or_the_time_of_a_failure():
    success = result(3)
    counted_as = {}
    for key, measure in MEASURES.items():
        values = measure.failure_values([success])
        if values is not None:
            (counted_as[key],) = values
    time_s = success.scores.failure_time_s
    assert counted_as == {
        **dict.fromkeys(("success", "challenge", "challenge_2022", "efficiency"), 0.0),
        "scored_time_s": time_s,
        "normalised_time_s_per_m": time_s / success.scores.path_length_m,
    }


def test_values_of_successes_leave_failed_trials_out():
    success = result(3)
    failed = replace(success, scores=replace(success.scores, success=False))
    for key, expected in (
        ("driven_m", [success.measures.driven_m, np.nan]),
        ("contact_s", [success.measures.contact_s] * 2),
        ("success", [1.0, 0.0]),
    ):
        values = MEASURES[key].values([success, failed])
        np.testing.assert_array_equal(values, expected)
    unknown = MEASURES["recoveries"].values([replace(success, recoveries=None)])
    np.testing.assert_array_equal(unknown, [np.nan])


def test_only_trials_among_moving_obstacles_have_their_measures():
    moving_result = moved()
    still = result(3)
    assert "phase_s" not in results_table([still]).column_names
    assert results_table([still, moving_result])["phase_s"].to_pylist() == [None, 7.0]
    assert all(np.isnan(MEASURES[key].raw_values([still])) for key in MOVING)
    assert with_moving_measures(("success",), [moving_result, still]) == (
        "success",
        *MOVING,
    )
    assert with_moving_measures(("success",), [moving_result], [still]) == ("success",)
    assert list(summarize_run([moving_result]).planners[0].means) == [
        *SCORED,
        *DRIVEN,
        *MOVING,
    ]
    other = replace(moving_result, planner="gap")
    assert [row.key for row in compare([moving_result], [other]).rows] == [
        *COMPARED,
        *MOVING,
    ]


def test_safety_is_clearance_to_movers_if_all_met_some():
    groups = [moved()], [moved(), result(3)]
    assert [clearance_measure(group).key for group in groups] == [
        "moving_clearance_m",
        "min_clearance_m",
    ]


def test_the_label_of_near_contact_names_its_distance():
    label = MEASURES["near_contact_s"].label
    assert label == f"time within {NEAR_CONTACT_M:g} m of obstacles"


def test_measures_are_named_once():
    assert require_measures(["success", "contact_s", "success"]) == (
        "success",
        "contact_s",
    )


def test_an_unknown_measure_is_refused():
    with refused("unknown measure 'succes'; did you mean 'success'"):
        require_measures(["succes"])


def test_shares_are_written_in_percent():
    assert MEASURES["success"].text(Interval(0.5, 0.25, 1.0)) == "50.0 [25.0, 100.0]"
    assert [MEASURES["success"].number(value) for value in (1.0, 0.25, None)] == [
        "100.0",
        "25.0",
        "-",
    ]
    assert MEASURES["challenge"].number(None) == "-"


def test_results_name_the_metric_of_their_protocol():
    named = replace(result(3), protocol="slow_challenge", metric="challenge")
    assert ranking_measure([named]).key == "challenge"
    assert (
        ranking_measure([replace(named, metric="normalised_time_s_per_m")]).key
        == "normalised_time_s_per_m"
    )


def test_rows_of_version_1_are_ranked_as_their_protocols_were():
    names = ("paper2020", "slow_challenge", "challenge")
    old = {
        name: ranking_measure([replace(result(3), protocol=name)]).key for name in names
    }
    assert old["paper2020"] == old["slow_challenge"] == "normalised_time_s_per_m"
    assert old["challenge"] == "challenge"


def test_tables_have_a_cell_per_measure():
    summary = summarize([result(3)], (*SCORED, *DRIVEN))
    table = summary_table([summary])
    assert [row[0] for row in table.rows[:-1]] == [
        MEASURES[key].heading for key in (*SCORED, *DRIVEN)
    ]
    assert table.title == "1 trial in 1 world"
    assert all("nan" not in cell for row in table.rows for cell in row[1:])
    assert trials_table([result(3)], "title").rows[0][:2] == (
        result(3).trial_id,
        "success",
    )
    assert [count_noun(number, "world") for number in (0, 1, 2)] == [
        "0 worlds",
        "1 world",
        "2 worlds",
    ]


def test_a_planner_has_one_color_whoever_is_beside_it():
    assert assign_colors(["dwa"]) == assign_colors(["mine", "eband", "dwa"])[2:]
    assert assign_colors(["eband", "dwa"]) == assign_colors(["dwa", "eband"])[::-1]
    assert assign_colors(["mine", "dwa"])[0] == assign_colors(["dwa", "mine"])[1]


def test_planners_of_a_figure_differ_in_color():
    names = ["dwa", "dwa", "mine", "eband", "mppi", "gap", "policy"]
    assert sorted(assign_colors(names)) == sorted(PLANNERS)
    assert len(assign_colors([*names, "eighth", "ninth"])) == 9


def test_planners_are_spelled_as_the_field_does():
    assert [spelling(name) for name in ("dwa", "eband", "mppi", "gap", "policy", "mine")] == [
        "DWA", "E-Band", "MPPI", "gap", "policy", "mine"
    ]  # fmt: skip
