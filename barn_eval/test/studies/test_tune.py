"""Tuning: which ranges are refused, that it goes on where it was stopped, and what it
writes and says.
"""

import pytest
import yaml
from refusals import refused
from text_tables import answers_of

from barn_worlds.base.errors import BarnError

pytest.importorskip("optuna")
from barn_eval.results.folder import read_results
from barn_eval.running.reporting import Reporter
from barn_eval.running.run import Run
from barn_eval.studies import tune as tuning
from barn_eval.studies.tune import Ranges

RANGES = {
    "max_speed_mps": {"low": 0.2, "high": 1.0},
    "directions": {"low": 51, "high": 151},
}
OPTIONS = {"worlds": "0,3,6,9,12,15", "workers": 1, "engine": "inline"}


def ranges_file(folder, parameters=RANGES, **fields):
    path = folder / "ranges.yaml"
    content = {"schema_version": 1, "planner": "gap", "parameters": parameters}
    path.write_text(yaml.safe_dump(content | fields))
    return str(path)


def tuned(folder, out="out", by=(), parameters=RANGES, settings=4, unseen="1,4"):
    ranges = Ranges.read(ranges_file(folder, parameters))
    options = OPTIONS | {"out": folder / out}
    return tuning.Tuner(ranges, options, by, unseen, Reporter()).tune(settings)


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in tuning.RANGES_FOLDER.glob("*.yaml"))
)
def test_shipped_ranges_are_read_and_hold_the_defaults(name, tmp_path):
    ranges = Ranges.read(name)
    params = "examples/nav2/params"
    options = {"out": tmp_path, "worlds": "0-5"}
    if not ranges.planner:
        root = tuning.Path(__file__).parents[3] / params
        names = ("common", "mapless", name.removeprefix("nav2_"))
        files = " ".join(f"--params-file {root / path}.yaml" for path in names)
        options["planner_command"] = f"nav2=host --ros-args {files}"
    tuner = tuning.Tuner(ranges, options, (), "6-9", Reporter())
    assert tuner.default.keys() == ranges.parameters.keys()


NO_RANGES = """
{}
    must have the key parameters
{max_speed_mps: {low: 1.0, high: 0.5}}
    max_speed_mps: must have low < high
{max_speed_mps: 3}
    max_speed_mps: must have low < high
{max_sped_mps: {low: 0.1, high: 0.5}}
    did you mean 'max_speed_mps'
{max_speed_mps: {low: 0.1, high: 0.4}}
    must allow the default, 0.5
"""


@pytest.mark.parametrize("parameters, words", answers_of(NO_RANGES))
def test_what_are_no_ranges_is_refused_in_one_line(parameters, words, tmp_path):
    with refused(words, BarnError):
        tuned(tmp_path, parameters=yaml.safe_load(parameters), settings=1)


def test_unknown_ranges_and_worlds_that_were_seen_are_refused(tmp_path):
    with refused("one of dwa, eband, gap, mppi", BarnError):
        Ranges.read("dvb")
    with refused("worlds of the data set that are not in --worlds", BarnError):
        tuned(tmp_path, unseen="2,3")
    with refused("unknown measure 'min_clearnce_m'", BarnError):
        tuned(tmp_path, by=["min_clearnce_m"])


def repeatable(folder):
    """Return what repeats of a folder's rows."""
    return [row.repeatable() for row in read_results(folder)]


def test_a_stopped_tuning_resumes_to_the_same_result(tmp_path, monkeypatch):
    whole = tuned(tmp_path)
    drive_scored = Run.drive_scored

    def stop(run, worlds):
        results = drive_scored(run, worlds)
        if len(list(tmp_path.glob("stopped/settings/*"))) == 3:
            raise KeyboardInterrupt
        return results

    monkeypatch.setattr(Run, "drive_scored", stop)
    with pytest.raises(KeyboardInterrupt):
        tuned(tmp_path, "stopped")
    monkeypatch.undo()
    again = tuned(tmp_path, "stopped")
    for setting, expected in zip(again.tuned, whole.tuned, strict=True):
        assert setting.values == expected.values
    for number in range(4):
        place = f"settings/{number:04}"
        expected = repeatable(tmp_path / "out" / place)
        assert expected
        assert repeatable(tmp_path / "stopped" / place) == expected
    with refused(r"holds a different tuning run: ranges\.", BarnError):
        tuned(tmp_path, parameters={"max_speed_mps": RANGES["max_speed_mps"]})


def test_what_is_written_drives_as_the_setting_that_was_judged(
    succeed, printed, tmp_path
):
    options = "--worlds 0,3,6,9,12,15 --unseen 1,4 --settings 4 --run engine=inline"
    line = f"tune {ranges_file(tmp_path)} {options} --out tuned"
    content = printed(line)
    (best,) = content["tuned"]
    assert best["seen"]["challenge"] > content["default_seen"]["challenge"]
    assert (content["worlds"], content["unseen"]) == (6, 2)
    assert content["given_up"] > 0
    assert best["unseen"]["b"] == "default"
    run = "run --worlds 1,4 --execution engine=inline --out alone"
    succeed(run, *best["files"])
    number = best["number"]
    unseen = tmp_path / "tuned" / "unseen" / f"{number:04}"
    assert repeatable(tmp_path / "alone") == repeatable(unseen)
    output = succeed(line)
    assert f"setting {number}" in output
    assert "2 worlds that the tuning did not use" in output


def test_several_measures_give_a_front_and_its_picture(tmp_path):
    result = tuned(tmp_path, by=("challenge", "min_clearance_m"))
    means = [setting.seen for setting in result.tuned]
    assert result.given_up == 0 and means
    for setting in means:
        for other in [*means, result.default_seen]:
            assert not all(other[key] > setting[key] for key in setting)
    assert (tmp_path / "out" / "front.png").stat().st_size > 1000


def test_parameters_of_a_command_are_written_as_its_own_file(tmp_path):
    source = tmp_path / "given.yaml"
    parameters = {"controller": {"ros__parameters": {"speed": 0.5, "rate": 20.0}}}
    source.write_text(yaml.safe_dump(parameters))
    speed = {"speed": {"low": 0.1, "high": 1.0}}
    ranges = Ranges.read(ranges_file(tmp_path, speed, planner=""))
    options = {
        "out": tmp_path / "out",
        "worlds": "0-5",
        "planner_command": f"m=run --params-file {source}",
    }
    tuner = tuning.Tuner(ranges, options, (), "6", Reporter())
    study = tuner.study
    for value in (0.5, 0.25):
        study.tell(study.ask(dict(ranges.parameters)), value)
    study.enqueue_trial({"speed": 0.3})
    setting = tuner.make_setting(study.ask(dict(ranges.parameters)), "settings")
    (path,) = tuner.write_files(2, setting, "better")
    parameters["controller"]["ros__parameters"]["speed"] = 0.3
    assert yaml.safe_load(path.read_text()) == parameters
