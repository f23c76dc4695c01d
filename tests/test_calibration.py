"""Agreement with published times, on a small made-up table."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from analysis.test_compare import write_folder
from calibrate import main
from calibration import calibrate
from click.testing import CliRunner
from forgery import edit_run
from published import published_trials, read_published
from refusals import refused
from results.test_rows import result as a_result
from scipy import stats
from text_tables import rows_of

from barn_eval.results.rows import RowFile
from barn_eval.results.run_file import RunFile
from barn_eval.trials.result import Outcome, format_trial_id

WORLDS = 10
LENGTH_M = 5.0
PUBLISHED = {
    world: [10.0 + world, 11.0 + world, 12.0 + world] for world in range(WORLDS)
}
MEANS = np.array([np.mean(times) for times in PUBLISHED.values()])


def write_run(path, times):
    """Write a run of times: {planner: {world: [time or None, ...]}}.

    None is a trial that reached the limit.
    """
    results = [
        make_result(planner, world, repetition, time_s)
        for planner, worlds in times.items()
        for world, times_s in worlds.items()
        for repetition, time_s in enumerate(times_s)
    ]
    return write_folder(path, results)


def make_result(planner, world, repetition, time_s):
    result = a_result(world)
    ended = Outcome.TIMEOUT if time_s is None else Outcome.SUCCESS
    scored_s = 50.0 if time_s is None else time_s
    scores = replace(
        result.scores,
        success=time_s is not None,
        scored_time_s=scored_s,
        path_length_m=LENGTH_M,
        normalised_time_s_per_m=scored_s / LENGTH_M,
    )
    return replace(
        result,
        trial_id=format_trial_id(planner, world, repetition),
        planner=planner,
        repetition=repetition,
        outcome=ended,
        scores=scores,
    )


def write_table(path, **planners):
    """Write a table of published times, three trials in each world."""
    names = [f"{planner}_{trial}" for planner in planners for trial in (1, 2, 3)]
    lines = [",".join(["world", "path_length_m", *names])]
    for world in PUBLISHED:
        times = [time for of_planner in planners.values() for time in of_planner[world]]
        lines.append(",".join(map(str, [world, LENGTH_M, *times])))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def table(tmp_path):
    return write_table(tmp_path / "trials.csv", dwa=PUBLISHED)


def test_the_same_times_agree_in_everything(tmp_path, table):
    run = write_run(tmp_path / "run", {"dwa": PUBLISHED})
    (calibration,) = calibrate([run], table).planners
    assert calibration.correlation.estimate == pytest.approx(1.0)
    assert calibration.correlation_of_successes.estimate == pytest.approx(1.0)
    assert calibration.bias_percent.estimate == pytest.approx(0.0, abs=1e-9)
    assert calibration.determination_of_equal_failures.estimate == pytest.approx(1.0)
    assert calibration.ours == calibration.published
    spread_s = np.std([10.0, 11.0, 12.0])
    assert calibration.ours.spread_s_per_m == pytest.approx(spread_s / LENGTH_M)
    assert calibration.easy_worlds == (0, 1)
    assert calibration.ours.easy_s.estimate == pytest.approx(11.5)
    assert calibration.ours.easy_range_s == pytest.approx((11.0, 12.0))


def test_published_failures_are_times_of_30_s_and_from_50_s(tmp_path):
    times = PUBLISHED | {0: [30.0, 50.0, 51.2], 1: [30.001, 29.999, 49.999]}
    published = read_published(write_table(tmp_path / "trials.csv", dwa=times))["dwa"]
    assert published.failed[:6].tolist() == [True, True, True, False, False, False]
    assert not published.failed[6:].any()


def mean_times(times_by_world, failure_s):
    """Return the mean time of each world, a failure counted as so many seconds."""
    means = []
    for times in times_by_world.values():
        means.append(np.mean([failure_s if time is None else time for time in times]))
    return np.array(means)


def test_failures_count_in_one_correlation_and_not_in_the_other(tmp_path, table):
    ours = {world: list(times) for world, times in PUBLISHED.items()}
    ours[0] = [None, 11.0, 12.0]
    ours[1] = [None, None, None]
    run = write_run(tmp_path / "run", {"dwa": ours})
    (calibration,) = calibrate([run], table).planners
    counted = mean_times(ours, failure_s=50.0)
    expected = stats.spearmanr(counted, MEANS).statistic
    assert expected < 0.5
    assert calibration.correlation.estimate == pytest.approx(expected)
    assert calibration.correlation_of_successes.estimate == pytest.approx(1.0)
    as_30_s = mean_times(ours, failure_s=30.0)
    expected = 100.0 * (counted.mean() / MEANS.mean() - 1.0)
    bias = calibration.bias_percent
    assert bias.estimate == pytest.approx(expected)
    assert bias.low < bias.estimate < bias.high
    time = calibration.ours.normalised_s_per_m
    assert time.estimate == pytest.approx(counted.mean() / LENGTH_M)
    expected = 100.0 * (as_30_s.mean() / MEANS.mean() - 1.0)
    bias = calibration.bias_percent_of_equal_failures
    assert bias.estimate == pytest.approx(expected)
    r2 = 1.0 - ((as_30_s - MEANS) ** 2).mean() / MEANS.var()
    assert r2 < 0.0
    assert calibration.determination_of_equal_failures.estimate == pytest.approx(r2)
    succeeded = [time for times in ours.values() for time in times if time is not None]
    ours_mean = np.mean(succeeded) / LENGTH_M
    assert calibration.ours.successes_s_per_m == pytest.approx(ours_mean)
    published_mean = MEANS.mean() / LENGTH_M
    assert calibration.published.successes_s_per_m == pytest.approx(published_mean)
    assert calibration.ours.failure_share.estimate == pytest.approx(4 / 30)
    assert calibration.published.failure_share.estimate == 0.0
    worlds = calibration.worlds[:3]
    assert [world.our_failures for world in worlds] == [1, 3, 0]
    assert [world.published_failures for world in worlds] == [0, 0, 0]
    assert calibration.worlds[1].ours_s == 50.0


def test_the_mean_of_both_is_compared_over_and_within_folders(tmp_path):
    falling = {world: PUBLISHED[WORLDS - 1 - world] for world in PUBLISHED}
    same = {world: [20.0] * 3 for world in PUBLISHED}
    table = write_table(tmp_path / "trials.csv", dwa=PUBLISHED, eband=same)
    dwa = write_run(tmp_path / "a", {"dwa": PUBLISHED})
    eband = write_run(tmp_path / "b", {"eband": falling})
    (joint,) = calibrate([dwa, eband], table).joint
    # Rising and falling times cancel out, so that every world has the same mean.
    assert joint.labels == ("DWA", "E-Band")
    assert joint.worlds == WORLDS
    assert not joint.correlation.estimate > 0.5
    both = write_run(tmp_path / "both", {"dwa": PUBLISHED, "eband": PUBLISHED})
    report = calibrate([both, dwa], table)
    assert [joint.labels for joint in report.joint] == [("DWA (both)", "E-Band")]
    assert report.joint[0].correlation.estimate == pytest.approx(1.0)
    # E-Band's published times do not vary, so half of what ours are off is left in the
    # mean of both.
    r2 = 1.0 - ((MEANS - 20.0) ** 2).mean() / MEANS.var()
    assert report.joint[0].determination_of_equal_failures.estimate == pytest.approx(r2)
    assert calibrate([dwa], table).joint == ()
    with edit_run(eband) as content:
        content["experiment"]["protocol"]["limit_s"] = 60.0
    task = RunFile.read(eband).task_fingerprint
    rows = RowFile(eband)
    rows.replace([replace(row, task=task) for row in rows.read()])
    assert calibrate([dwa, eband], table).joint == ()


def test_only_common_worlds_and_planners_of_the_table_take_part(tmp_path, table):
    some = {world: PUBLISHED[world] for world in (2, 3, 4)} | {77: [15.0]}
    run = write_run(tmp_path / "run", {"dwa": some, "mppi": some})
    (calibration,) = calibrate([run], table).planners
    assert [world.world for world in calibration.worlds] == [2, 3, 4]
    assert (calibration.ours.trials, calibration.published.trials) == (9, 9)


# Header, line and problem.
TABLES = """
world,dwa_1               | 0,10     | line 2: path_length_m must be a number above 0, got None
world,path_length_m       | 0,5.0    | columns of times, such as dwa_1
world,path_length_m,dwa_1 |          | at least one world
world,path_length_m,dwa_1 | 0,5.0,soon | line 2: dwa_1 must be a number above 0, got 'soon'
world,path_length_m,dwa_1 | 0,-1,10  | line 2: path_length_m must be a number above 0, got '-1'
world,path_length_m,eband_1 | 0,5,10 | has times of eband, the results of none of these
world,path_length_m,dwa_1 | 55,5,10  | no world in common with the results of DWA
world,path_length_m,dwa_1 | 0,6,10   | the path of world 0 is 6.000 m there and 5.000 m in the results
"""


@pytest.mark.parametrize("header, line, words", rows_of(TABLES))
def test_what_cannot_be_compared_is_named(tmp_path, header, line, words):
    path = tmp_path / "trials.csv"
    path.write_text(f"{header}\n{line}\n")
    run = write_run(tmp_path / "run", {"dwa": PUBLISHED})
    with refused(words):
        calibrate([run], path)


def test_published_times_are_read_with_the_worlds_beside_them(original_folder):
    table = original_folder / "trials.csv"
    worlds, trials = published_trials(table)
    assert (len(worlds), len(trials)) == (50, 500)
    assert trials.planner_names == ("dwa", "eband")
    with table.open() as file:
        first = next(csv.DictReader(file))
    columns = [name for name in first if name.startswith(("dwa_", "eband_"))]
    assert len(columns) == 10
    times = [float(first[name]) for name in columns]
    length_m = float(first["path_length_m"])
    assert trials.difficulty()[0] == pytest.approx(np.mean(times) / length_m)


def invoke(*arguments):
    return CliRunner().invoke(main, [*map(str, arguments)], catch_exceptions=False)


@pytest.mark.parametrize(
    "suffix, magic", [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]
)
def test_command_draws_and_prints(tmp_path, suffix, magic):
    ours = PUBLISHED | {3: [None, 12.0, 13.0]}
    eband = PUBLISHED | {4: [30.0, 30.0, 30.0]}
    table = write_table(tmp_path / "trials.csv", dwa=PUBLISHED, eband=eband)
    run = write_run(tmp_path / "run", {"dwa": ours, "eband": ours})
    figure = tmp_path / f"scatter.{suffix}"
    drawn = invoke(run, "--reference", table, "--figure", figure, "--json")
    content = json.loads(drawn.stdout)
    assert [planner["label"] for planner in content["planners"]] == ["DWA", "E-Band"]
    published = content["planners"][1]["published"]
    assert published["failure_share"]["estimate"] == 0.1
    assert figure.read_bytes().startswith(magic)
    text = " ".join(invoke(run, "--reference", table).stdout.split())
    assert "Spearman, failures counted" in text
    assert "R2, each failure as 30 s" in text
    assert "mean of DWA and E-Band over 10 worlds" in text


# Option, value and problem.
MISTAKES = """
reference | none.csv           | none.csv: No such file or directory
folder    | nowhere            | nowhere: holds no results of a run
figure    | run/run.json/a.png | cannot be written
figure    | scatter.bmp        | scatter.bmp: must end in .png, .svg, .pdf
"""


@pytest.mark.parametrize("option, value, words", rows_of(MISTAKES))
def test_mistakes_are_one_line(tmp_path, table, option, value, words):
    write_run(tmp_path / "run", {"dwa": PUBLISHED})
    names = {"folder": "run", "reference": table.name, "figure": "scatter.png"}
    names[option] = value
    folder, reference, figure = (tmp_path / name for name in names.values())
    done = invoke(folder, "--reference", reference, "--figure", figure)
    assert done.exit_code != 0
    error = done.stderr.splitlines()[-1]
    assert error.startswith("Error: ") and words in error
    assert not (tmp_path / "scatter.png").exists()
