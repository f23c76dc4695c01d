"""Comparisons of results, and what cannot be compared."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import yaml
from refusals import refused
from results.test_rows import result as a_result
from text_tables import rows_of

from barn_eval.analysis.compare import (
    adjust_by_holm,
    compare,
    compare_folders,
    count_available_worlds,
    label_groups,
    read_selections,
)
from barn_eval.analysis.measures import COMPARED, DRIVEN, MOVING, SCORED
from barn_eval.analysis.summary import summarize_run
from barn_eval.analysis.tables import comparison_table
from barn_eval.results.rows import RowFile
from barn_eval.results.run_file import RunFile
from barn_eval.running.command_files import write_node_parameters
from barn_eval.trials.encounters import Encounters
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.result import Outcome, WallClock, format_trial_id
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_planners.registry import planner_config
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError
from barn_worlds.base.files import make_json_safe


def results(planner="dwa", slower_s=0.0, worlds=20, seed=0):
    """Return three trials in each world, slow worlds for both planners alike."""
    draw = np.random.default_rng(seed)
    rows = []
    for world in range(worlds):
        world_s = draw.uniform(10.0, 30.0)
        for repetition in range(3):
            time_s = world_s + slower_s + draw.normal(0.0, 0.5)
            row = replace(
                a_result(world),
                trial_id=format_trial_id(planner, world, repetition),
                planner=planner,
                repetition=repetition,
                simulator_seed=100 * world + repetition,
            )
            times = dict.fromkeys(("traversal_time_s", "scored_time_s"), time_s)
            rows.append(scored(row, normalised_time_s_per_m=time_s / 5.0, **times))
    return rows


def scored(row, **scores):
    """A result with some of its scores changed."""
    return replace(row, scores=replace(row.scores, **scores))


def measured(row, **measures):
    """A result with some of its measures changed."""
    return replace(row, measures=replace(row.measures, **measures))


def failed(row):
    return scored(
        replace(row, outcome=Outcome.TIMEOUT),
        success=False,
        scored_time_s=50.0,
        challenge=0.0,
    )


def test_a_difference_that_worlds_hide_is_found_by_pairs():
    comparison = compare(results(), results("eband", slower_s=1.0))
    row = comparison.row("scored_time_s")
    assert row.paired.trials == 60
    assert row.paired.difference.estimate == pytest.approx(-1.0, abs=1e-9)
    assert row.paired.improvement.estimate > 0.8
    assert comparison.rank_correlation.estimate > 0.9
    assert [row.key for row in comparison.rows] == list(COMPARED)


def test_a_comparison_says_who_is_better_by_each_measure():
    """The first does better by every measure that has a side."""
    good = results(worlds=3)
    worse_scores = {
        "success": False,
        "scored_time_s": 50.0,
        "normalised_time_s_per_m": 9.9,
        "challenge": 0.0,
    }
    worse = {"min_clearance_m": 0.05, "contact_s": 1.0, "rms_jerk_mps3": 2.0}
    bad = [scored(row, **worse_scores) for row in results("eband", worlds=3)]
    bad = [measured(row, **worse) for row in bad]
    comparison = compare(good, bad)
    better = {
        key: comparison.row(key).paired.improvement.estimate
        for key in (*worse_scores, *worse)
    }
    assert better == dict.fromkeys(better, 1.0)
    longer = [measured(row, driven_m=6.0, rotation_rad=2.0) for row in good]
    comparison = compare(good, longer)
    for key in ("driven_m", "rotation_rad"):
        assert comparison.row(key).paired.improvement.estimate == 1.0


def test_a_row_names_its_measure_with_unit_and_side():
    row = compare(results(worlds=1), results("eband", worlds=1)).row("contact_s")
    assert (row.key, row.measure, row.unit) == ("contact_s", "time in contact", "s")
    assert row.larger_is_better is False


def test_one_trial_each_is_compared():
    (a, *_), (b, *_) = results(), results("eband")
    comparison = compare([a], [b])
    assert (comparison.a, comparison.b) == ("dwa", "eband")
    assert (comparison.protocol, comparison.task) == ("paper2020", "")
    counts = ("trials_a", "trials_b", "worlds", "pairs")
    assert {getattr(comparison, name) for name in counts} == {1}


def test_moving_measures_are_compared_if_both_have_them():
    met = Encounters(7.0, 0.25, 1.5, 2.0, 1.25, 2.5)
    still = results(worlds=1)
    moved = [replace(trial, motion=met) for trial in results(worlds=1)]
    for a, b in product((still, moved), repeat=2):
        keys = [row.key for row in compare(a, b, keys=()).rows]
        both = MOVING if a is b is moved else ()
        assert keys == ["normalised_time_s_per_m", *both]


def test_a_comparison_counts_the_worlds_of_its_data_set():
    unknown, of_barn300 = (results(name, worlds=1) for name in ("dwa", "eband"))
    of_barn300 = [replace(row, dataset="barn300") for row in of_barn300]
    assert compare(of_barn300, unknown).available == 300
    assert compare(unknown, of_barn300).available == 0
    assert count_available_worlds(of_barn300[:1]) == 300
    assert count_available_worlds(of_barn300[:1] + unknown) == 300
    assert count_available_worlds([]) == 0


def test_a_comparison_is_a_row_of_a_table_by_measure():
    a = results(worlds=2)
    b = results("eband", slower_s=2.0, worlds=2, seed=1)
    comparison = compare(a, b)
    rows = {row["measure"]: row for row in comparison.columns()}
    row = rows["scored_time_s"]
    paired = comparison.row("scored_time_s").paired
    times = [[result.scores.scored_time_s for result in part] for part in (a, b)]
    difference = paired.difference
    assert row == {
        "a": "dwa",
        "b": "eband",
        "measure": "scored_time_s",
        "unit": "s",
        "worlds": 2,
        "trials": 6,
        "mean_a": pytest.approx(np.mean(times[0])),
        "mean_b": pytest.approx(np.mean(times[1])),
        "difference": difference.estimate,
        "difference_low": difference.low,
        "difference_high": difference.high,
        "p": paired.p,
        "p_holm": paired.p,
        "p_a_better": paired.improvement.estimate,
    }
    assert list(rows) == list(COMPARED)
    assert {tuple(result) for result in rows.values()} == {tuple(row)}


def test_rank_correlation_is_of_the_time_per_metre_in_each_world():
    a, b = (
        [
            scored(row, normalised_time_s_per_m=float(times[row.world]))
            for row in results(name, worlds=3)
        ]
        for name, times in (("dwa", (1, 2, 3)), ("eband", (10, 30, 20)))
    )
    assert compare(a, b).rank_correlation.estimate == pytest.approx(0.5)


def test_time_of_successes_needs_both_to_succeed():
    a = results()
    b = results("eband")
    a[0], b[1] = failed(a[0]), failed(b[1])
    comparison = compare(a, b)
    assert comparison.row("success").paired.trials == 60
    assert comparison.row("success").paired.difference.estimate == 0.0
    assert comparison.row("traversal_time_s").paired.trials == 58


def test_only_what_both_have_is_compared():
    comparison = compare(results()[:30], results("eband"))
    assert (comparison.trials_a, comparison.trials_b) == (30, 60)
    assert comparison.row("success").paired.trials == 30


OTHER_TASKS = r"""
- [{task: ff}, 'have different tasks \(protocol, simulator or robot\): , ff']
- [{protocol: challenge}, "have different protocols: paper2020, challenge"]
- [{world_checksum: ff}, "have different worlds of the same number: 00, ff"]
- [{simulator_seed: 77}, "have different simulator seeds: 0, 77"]
"""


@pytest.mark.parametrize("change, words", yaml.safe_load(OTHER_TASKS))
def test_what_is_not_the_same_task_is_refused(change, words):
    other = results("eband")
    with refused(words, BarnError):
        compare(results(), [replace(other[0], **change), *other[1:]])


def test_nothing_in_common_and_mixed_planners_are_refused():
    elsewhere = [replace(row, world=5) for row in results("eband", worlds=1)]
    with refused("no world and repetition in common", BarnError):
        compare(results(worlds=1), elsewhere)
    with refused("several planners cannot be compared as one", BarnError):
        compare(results() + results("eband"), results())


def test_summary_of_a_campaign_has_each_planner_and_each_pair():
    summary = summarize_run(
        results("dwa") + results("eband", 1.0) + results("gap", 2.0)
    )
    assert [item.planner for item in summary.planners] == ["dwa", "eband", "gap"]
    assert [(item.a, item.b) for item in summary.comparisons] == [
        ("dwa", "eband"),
        ("dwa", "gap"),
        ("eband", "gap"),
    ]
    dwa = summary.planners[0]
    assert list(dwa.means) == [*SCORED, *DRIVEN]
    assert dwa["min_clearance_m"].estimate == pytest.approx(0.1)
    assert dwa["path_ratio"].estimate == pytest.approx(5.5 / 5.0)
    assert np.isnan(dwa["recoveries"].estimate)
    assert dwa["success"].estimate == 1.0


def test_limits_hold_the_mean_of_what_has_no_best_value():
    often = [replace(row, recoveries=3 + row.world) for row in results()]
    recoveries = summarize_run(often).planners[0]["recoveries"]
    assert recoveries.low < recoveries.estimate == 12.5 < recoveries.high


def write_folder(path, content, worlds="0-3", protocol=PAPER_2020, **choice):
    """Write results as the folder of an experiment with as many repetitions as they
    have.
    """
    path.mkdir()
    names = dict.fromkeys(row.planner for row in content)
    planners = tuple(PlannerChoice(name, **choice) for name in names)
    repetitions = 1 + max(row.repetition for row in content)
    rules = {"protocol": protocol, "simulator": simulator_config(protocol)}
    config = RunConfig(
        worlds=worlds, planners=planners, repetitions=repetitions, **rules
    )
    RunFile.for_run(path, config, []).write()
    for row in content:
        RowFile(path).append(row)
    return path


@pytest.fixture
def folders(tmp_path):
    dwa = results(worlds=4)
    eband = results("eband", 1.0, worlds=4)
    for name, content in (("a", dwa), ("b", eband), ("both", dwa + eband)):
        write_folder(tmp_path / name, content)
    return tmp_path


def test_equal_figures_have_equal_p_values():
    """Without a failure, times of successes are the times as counted."""
    comparison = compare(results(worlds=5), results("eband", 2.0, worlds=5, seed=1))
    of_successes = comparison.row("traversal_time_s")
    counted = comparison.row("scored_time_s")
    assert of_successes.paired.mean_a == counted.paired.mean_a
    assert of_successes.paired == counted.paired


def test_command_compares_folders(folders, command, printed):
    (pair,) = printed(f"compare {folders}/a {folders}/b")
    assert (pair["a"], pair["b"]) == ("dwa", "eband")
    assert pair["rows"][0]["paired"]["trials"] == 12
    (pair,) = printed(f"compare {folders}/a {folders}/both:eband")
    assert pair["b"] == "eband"
    first, other = printed(f"compare {folders}/both {folders}/both")
    assert (first["a"], other["a"]) == (
        f"DWA ({folders}/both)",
        f"E-Band ({folders}/both)",
    )
    assert first["rows"][0]["paired"]["difference"]["estimate"] == 0.0
    assert first["verdict"].startswith("DWA") and first["pairs"] == 2
    assert first["rank_correlation"]["low"] is None  # worlds with equal ranks show none
    text = " ".join(command(f"compare {folders}/a {folders}/b")[1].split())
    assert "same worlds and seeds" in text
    assert text.startswith(
        "protocol paper2020, task not recorded "
        "DWA ranks first; its lead over E-Band is not significant (p = 0.935"
    )
    assert "Only 4 worlds: with fewer than 10" in text


def test_folders_are_compared_in_the_order_given(folders):
    (comparison,) = compare_folders(folders / "a", folders / "b")
    difference = comparison.row("scored_time_s").paired.difference
    assert difference.estimate == pytest.approx(-1.0)
    write_folder(folders / "copy", results(worlds=4) + results("eband", 1.0, worlds=4))
    pairs = compare_folders(folders / "both", folders / "copy")
    names = [(pair.a, pair.b) for pair in pairs]
    assert names == [("DWA (both)", "DWA (copy)"), ("E-Band (both)", "E-Band (copy)")]


def test_folders_of_the_same_name_are_named_by_their_paths(folders):
    (folders / "later").mkdir()
    other = write_folder(folders / "later" / "a", results(worlds=4))
    (pair,) = compare_folders(folders / "a", other)
    assert (pair.a, pair.b) == (f"DWA ({folders}/a)", f"DWA ({other})")


def test_parameters_in_which_planners_differ_are_told(folders, command):
    write_folder(folders / "slow", results(worlds=4))

    def changed(name, *changes):
        run = folders / name / "run.json"
        for before, after in changes:
            run.write_text(run.read_text().replace(before, after))
        return compare_folders(folders / "a", folders / "slow")[0].parameters

    assert changed("a") == ""
    default = '"overrides": {}'
    slower = '"overrides": {"dwa.max_speed_mps": 0.3}'
    expected = "dwa dwa.max_speed_mps (0.5 against 0.3)."
    assert changed("slow", (default, slower)) == f"Parameters that differ: {expected}"
    foreign = (('"mode": "direct"', '"mode": "ros"'), (slower, default))
    for name, speed in (("a", 0.5), ("slow", 1.0)):
        logs = folders / name / "logs" / "dwa_0"
        logs.mkdir(parents=True)
        told = f'{{"/nav speed": "{speed}", "/{name} x": "1"}}'
        write_node_parameters(logs.parent, logs, "dwa", told)
        files = f'"files": {{"p.yaml": "{name * 64}", "{name}.yaml": "0"}}'
        driven = ('"command": ""', f'{files}, "command": "drive"')
        sentence = changed(name, *foreign, driven)
    expected = f"file p.yaml ({'a' * 12} against {('slow' * 3)[:12]}) and /nav speed (0.5 against 1.0)."
    assert sentence == f"Parameters that differ: {expected}"
    text = command(f"compare {folders}/a {folders}/slow")[1]
    assert expected in " ".join(text.split())


@pytest.mark.parametrize("count", [5, 6])
def test_the_first_five_parameters_that_differ_are_named(folders, count):
    parameters = as_dict(planner_config("dwa", "paper2020"))["dwa"]
    numbers = {
        f"dwa.{key}": value
        for key, value in parameters.items()
        if isinstance(value, float)
    }
    halved = {key: 0.5 * numbers[key] for key in list(numbers)[:count]}
    write_folder(folders / "halved", results(worlds=4), overrides=halved)
    sentence = compare_folders(folders / "a", folders / "halved")[0].parameters
    names = [word for word in sentence.split() if word.startswith("dwa.")]
    assert names == list(halved)[:5]
    assert (f" {count - 5} more" in sentence) == (count > 5)


def test_an_uninstalled_planner_reports_no_parameter(folders):
    for name in ("one", "two"):
        write_folder(folders / name, results("gone", worlds=4))
    assert compare_folders(folders / "one", folders / "two")[0].parameters == ""


def write_three(folders):
    """Write a folder of three planners."""
    slower_s = {"dwa": 0.0, "eband": 1.0, "gap": 2.0}
    parts = (results(name, time_s, worlds=4) for name, time_s in slower_s.items())
    write_folder(folders / "three", [row for part in parts for row in part])


def test_the_share_of_pairs_that_is_compared_is_told(folders):
    shares = []
    write_three(folders)
    compare_folders(folders / "three", keys=(), progress=shares.append)
    assert shares == [1 / 3, 2 / 3, 1.0]


def test_folders_of_different_tasks_are_refused_by_key(folders):
    rules = replace(PAPER_2020, failure_time_s=60.0)
    write_folder(folders / "other", results("eband", worlds=4), protocol=rules)
    words = "different tasks cannot be compared: protocol.failure_time_s is 30.0 in .*, 60.0"
    with refused(words, BarnError):
        compare_folders(folders / "a", folders / "other")


def test_planners_of_several_folders_are_told_apart(folders):
    groups = label_groups(read_selections(folders / "both"))
    planners = {name: group[0].planner for name, group in groups.items()}
    assert planners == {"DWA": "dwa", "E-Band": "eband"}
    assert list(label_groups(read_selections(folders / "b", folders / "a"))) == [
        "E-Band",
        "DWA",
    ]
    assert list(label_groups(read_selections(folders / "a", folders / "both"))) == [
        f"DWA ({folders / 'a'})",
        f"DWA ({folders / 'both'})",
        "E-Band",
    ]


def test_planners_of_one_folder_are_compared_with_each_other(folders, printed):
    write_three(folders)
    pairs = [(pair.a, pair.b) for pair in compare_folders(folders / "three")]
    assert pairs == [("dwa", "eband"), ("dwa", "gap"), ("eband", "gap")]
    (entry,) = printed(f"compare {folders}/three:dwa,gap")
    assert (entry["a"], entry["b"]) == ("dwa", "gap")
    pair = as_dict(compare_folders(folders / "three:dwa", folders / "three:gap")[0])
    assert entry["rows"] == json.loads(json.dumps(make_json_safe(pair["rows"])))
    with refused("/a: has only one planner, dwa; name a second folder", BarnError):
        compare_folders(folders / "a")


def test_an_unfinished_folder_is_told(folders):
    unfinished = write_folder(
        folders / "begun", results("eband", 1.0, worlds=4), worlds="0-5"
    )
    (comparison,) = compare_folders(folders / "a", unfinished)
    assert comparison.notes == [f"{unfinished} is partial: 12 of 18 trials"]
    assert comparison.notes[0] in comparison_table(comparison).caption


def test_trials_with_late_commands_are_told(folders):
    missed = WallClock(missed_cycles=9, missed_share=0.03)
    late = [replace(row, wall_clock=missed) for row in results("eband", 1.0, worlds=1)]
    folder = write_folder(
        folders / "late",
        late + [row for row in results("eband", 1.0, worlds=4) if row.world],
    )
    (comparison,) = compare_folders(folders / "a", folder)
    (note,) = comparison.notes
    assert note.startswith(
        f"{len(late)} of 12 trials in {folder} are marked: more than 2% of their control periods"
    )


def test_the_table_marks_what_is_clear_after_holm(folders):
    clear = compare(results(), results("eband", slower_s=5.0))
    cells = {row[0]: row for row in comparison_table(clear).rows}
    assert comparison_table(clear).columns[4] == "p"
    assert cells["time as counted [s]"][4] == "<0.001 *"
    assert cells["success [%]"][4] == "1.000"
    many = adjust_by_holm([clear] * 8)[0]
    assert comparison_table(many).columns[4] == "p (Holm, 8 pairs)"


def test_comparisons_by_other_measures_are_not_adjusted_together():
    a = results(worlds=1)
    b = results("eband", worlds=1)
    every = compare(a, b)
    # The third one is told, as it lacks measures that the others have.
    with pytest.raises(ValueError, match="argument 3 is shorter"):
        adjust_by_holm([every, every, compare(a, b, keys=("success",))])


def test_a_folder_whose_name_has_a_colon_is_that_folder(folders):
    (folders / "b").rename(folders / "b:today")
    (comparison,) = compare_folders(folders / "a", folders / "b:today")
    assert (comparison.a, comparison.b) == ("dwa", "eband")


def test_folders_without_a_common_planner_need_a_choice(folders):
    write_folder(folders / "other", results("gap", worlds=1)[:1])
    with refused(
        r"has dwa, eband and .*other has gap: select planners as FOLDER:PLANNER",
        BarnError,
    ):
        compare_folders(folders / "both", folders / "other")


def test_command_names_what_is_missing(folders, rejected):
    assert "holds no results of a run" in rejected(f"compare {folders} {folders}/a")
    message = rejected(f"compare {folders}/a {folders}/both:ebnd")
    assert "no planner 'ebnd'; did you mean 'eband'" in message
    message = rejected(f"compare {folders}/a/results.jsonl")
    assert f"must be a folder of results; name {folders}/a" in message
    (folders / "a" / "run.json").unlink()
    assert "a/run.json: No such file or directory" in rejected(
        f"compare {folders}/a {folders}/b"
    )


DECISIONS = """
- [0.0, "scored_time_s:2", not worse, 0]
- [0.0, "scored_time_s:10%", not worse, 0]
- [5.0, "scored_time_s:2", worse, 4]
- [5.0, "scored_time_s:5", not shown, 5]
- [5.0, "scored_time_s:30%", not worse, 0]
"""


@pytest.mark.parametrize("slower_s, margin, decision, code", yaml.safe_load(DECISIONS))
def test_a_planner_must_be_shown_not_to_be_worse(
    command, tmp_path, slower_s, margin, decision, code
):
    """Nobody fails here, but each may in up to 17% of its trials."""
    a = results()
    b = results("eband", slower_s)
    counted = [[scored(row, failure_time_s=20.0) for row in part] for part in (a, b)]
    for part in counted:
        write_folder(tmp_path / part[0].planner, part, worlds="0-19")
    line = f"compare dwa eband --fail-if-worse {margin}"
    ended, out, _ = command(f"{line} --json")
    assert ended == code
    (test,) = json.loads(out)[0]["decisions"]
    assert (test["decision"], test["measure"]) == (decision, "scored_time_s")
    assert test["loss"] == pytest.approx(slower_s, abs=0.5)
    words = {
        0: "eband is not worse than dwa by more than",
        4: "eband is worse than",
        5: "the data do not show that eband",
    }
    assert words[code] in " ".join(command(line)[1].split())


def test_what_cannot_be_told_apart_is_not_shown_to_be_no_worse(folders, command):
    """Four worlds have no limits at all."""
    code, out, _ = command(
        f"compare {folders}/a {folders}/b --fail-if-worse path_ratio:1 --json"
    )
    (content,) = json.loads(out)
    assert code == 5
    assert content["rows"][-1]["key"] == "path_ratio"
    assert content["decisions"][0]["high"] is None


MARGINS = """
sucess:1   | unknown measure 'sucess'; did you mean 'success'
success    | must be MEASURE:MARGIN
success:-1 | must be MEASURE:MARGIN
success:x% | must be MEASURE:MARGIN
"""


@pytest.mark.parametrize("text, words", rows_of(MARGINS))
def test_margins_that_say_nothing_are_told(folders, rejected, text, words):
    assert words in rejected(f"compare {folders}/a {folders}/b --fail-if-worse {text}")
