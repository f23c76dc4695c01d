"""A survey finds obstacles where they stand, and names those that it is not sure of."""

from dataclasses import replace

import numpy as np
import pytest
from planners import run_inline
from refusals import refused

import barn_eval as barn
from barn_eval.commands.main import main
from barn_eval.results.bags.recorded import ODOM, read_recorded_trial
from barn_eval.studies.survey import survey_course
from barn_eval.trials.protocol import CHALLENGE
from barn_worlds.base.errors import BagError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.world_yaml import read_world_yaml, write_world_yaml

NUMBER = 120
PLAN = open_dataset("barn300").load(NUMBER)
START = CHALLENGE.course(PLAN).start


def drive(folder, built_m):
    """Return the bag of a drive among cylinders at other places than planned."""
    file = folder / f"built_{NUMBER}.world.yaml"
    write_world_yaml(replace(PLAN, built_m=built_m), file)
    run = {"dataset": str(file), "bags": "all", "out": folder / "out"}
    run_inline(worlds="all", planners=["gap"], protocol="challenge", **run)
    return folder / f"out/bags/gap_w{NUMBER:04d}_r00"


@pytest.fixture(scope="module", params=[0.01, 0.02])
def built(request, tmp_path_factory):
    """The places of cylinders, 1 or 2 cm (sd) off, and the bag of a drive."""
    generator = np.random.default_rng(7)
    offsets_m = generator.normal(0.0, request.param, PLAN.planned_m.shape)
    built_m = PLAN.planned_m + offsets_m.clip(-0.045, 0.045)
    return built_m, drive(tmp_path_factory.mktemp("built"), built_m)


def test_what_is_well_seen_is_found_to_3_mm(built):
    built_m, bag = built
    survey = barn.worlds.survey(bag, PLAN)
    errors_m = np.hypot(*(survey.centers_m - built_m).T)
    table = survey.table()
    sure = np.flatnonzero(table.unsure == "")
    assert len(sure) > 0.6 * len(built_m)
    assert errors_m[sure].max() < 0.003
    # The errors that it states are those that it makes.
    share = errors_m[sure] / survey.errors_m[sure]
    assert 0.5 < np.sqrt(np.mean(share**2)) < 2.0
    assert set(table.unsure[117:121]) == {"not seen"}
    # Two returns may be of a neighbor, so the error that follows from them is too small.
    few = replace(survey, returns=np.full(len(built_m), 2))
    assert set(few.table().unsure[sure]) == {"seen too little"}


def test_by_odometry_alone_places_hold_among_each_other(built):
    built_m, bag = built
    trial = read_recorded_trial(bag)
    alone = replace(trial, frame=ODOM, poses=trial.odometry)
    survey = survey_course(alone, PLAN, START, 0.02)
    assert survey.datum == "plan"
    table = survey.table()
    sure = np.flatnonzero(table.unsure == "")
    off_m = survey.centers_m[sure] - built_m[sure]
    # The whole course is shifted and turned by a little, which no scan shows.
    turned = np.column_stack([np.ones(len(sure)), built_m[sure]])
    off_m -= turned @ np.linalg.lstsq(turned, off_m, rcond=None)[0]
    assert np.hypot(*off_m.T).max() < 0.003


def test_the_course_as_built_is_driven(built, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where results go
    _, bag = built
    out = tmp_path / f"as_built_{NUMBER}.world.yaml"
    with pytest.raises(SystemExit, match="0"):
        main(["course", "survey", str(bag), "--world", "120", "--out", str(out)])
    assert "not seen" in capsys.readouterr().out
    world = read_world_yaml(out)
    assert world.checksum != PLAN.checksum
    assert np.array_equal(world.cylinders_m[117:121], PLAN.planned_m[117:121])
    results = run_inline(
        worlds="all", planners=["gap"], protocol="challenge", dataset=str(out)
    )
    assert results.trials[0].world_checksum == world.checksum


def test_scans_of_another_world_are_refused(built):
    _, bag = built
    other = open_dataset("barn300").load(270)
    with refused(r"do not fit world_270: \d+% of the returns", BagError):
        barn.worlds.survey(bag, other)


def test_poses_in_mm_are_refused(built):
    trial = read_recorded_trial(built[1])
    poses = trial.odometry * [1000.0, 1000.0, 1.0]
    wrong = replace(trial, frame=ODOM, poses=poses, odometry=poses)
    with refused("locate no obstacle of world_120; poses must", BagError):
        survey_course(wrong, PLAN, START, 0.02)
