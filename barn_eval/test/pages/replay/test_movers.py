"""Moving obstacles in replays, films, reports and overlays.

Drawn where they were, and counted in the clearance.
"""

import base64
import zlib
from dataclasses import replace

import numpy as np
import planners
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from pages.replay.test_files import collections_of
from pages.replay.test_page import some_of
from PIL import Image
from planners import spec_of
from report_work import drive

from barn_eval.pages.replay.files import write_replay
from barn_eval.pages.replay.page import list_facts, replay_page
from barn_eval.pages.replay.payload import bounds, make_payload
from barn_eval.pages.report.maps import overlay
from barn_eval.pages.report.page import build_report, report_page
from barn_eval.pages.report.trials import page_data, world_part
from barn_eval.results.bags.movers import RecordedMotions, compute_gaps
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.folder import read_results
from barn_eval.trials.protocol import DYNABARN
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.geometry.bodies import Bodies, wall_bodies

WORLD = 30


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two planners in one world of DynaBARN, with bags."""
    return drive(
        tmp_path_factory.mktemp("motion") / "run", DYNABARN, ("gap", "dwa"), str(WORLD)
    )


@pytest.fixture(scope="module")
def bag(folder):
    return folder / "bags" / f"gap_w{WORLD:04d}_r00"


@pytest.fixture(scope="module")
def world():
    return open_dataset("dynabarn60").load(WORLD)


def standing(count):
    return Bodies(
        np.zeros((count, 3)), np.full(count, 0.5), np.zeros((count, 2)), np.ones(count)
    )


def test_between_poses_and_after_the_last_motion_is_straight():
    times_s = np.array([0.0, 0.1, 0.2, 0.3])
    places = np.zeros((4, 2, 2))
    places[:, 0, 0] = [0.0, 0.1, 0.2, 0.3]
    places[:, 1, 1] = [0.0, 0.2, 0.4, -5.0]
    moving = RecordedMotions(times_s, places, standing(2), standing(0))
    assert np.argwhere(moving.jumps).tolist() == [[3, 1]]
    assert moving.jumps.shape == (4, 2)
    positions = moving.at(np.array([-1.0, 0.05, 0.25, 0.299, 0.3, 0.35, 9.0]))
    x_m, y_m = positions[:, 0, 0], positions[:, 1, 1]
    assert x_m == pytest.approx([0.0, 0.05, 0.25, 0.299, 0.3, 0.35, 0.4])
    assert y_m == pytest.approx([0.0, 0.1, 0.4, 0.4, -5.0, -5.0, -5.0])
    straight, jumped = moving.trails(0.3)
    assert straight[:, 0] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.3])
    assert list(jumped[:, 1]) == [-5.0, -5.0]
    first = RecordedMotions(times_s[:1], places[:1], standing(2), standing(0))
    assert len(first.at(times_s)) == 4


def test_poses_and_clearance_are_those_of_the_result(bag, world):
    recorded = read_recorded_trial(bag)
    moving = recorded.moving
    motion = recorded.result["motion"]
    exact = world.tracks.over(recorded.times_s + motion["phase_s"])[0]
    off_m = np.linalg.norm(moving.at(recorded.times_s) - exact, axis=2)
    assert np.median(off_m) < 1e-3
    assert (off_m > 0.02).mean() < 0.01
    assert (off_m > 0.5).sum() <= moving.jumps.sum()  # a jump lies between two poses
    expected = compute_gaps(
        moving.bodies, wall_bodies(world.walls), exact, recorded.poses, recorded.outline
    )
    apart_m = np.abs(recorded.clearance_m - expected)
    assert np.median(apart_m) < 1e-3
    assert (apart_m > 0.02).mean() < 0.02
    assert recorded.clearance_m.min() == pytest.approx(
        motion["moving_clearance_m"], abs=0.02
    )
    assert bounds(recorded) == pytest.approx((-10.5, -10.5, 12.1, 10.5), abs=0.1)
    assert not [note for note in recorded.notes if "moving" in note]


@pytest.mark.parametrize("topic", ["/moving_obstacles", "/moving_obstacles/poses"])
def test_without_shapes_or_poses_the_page_says_why(bag, tmp_path, topic):
    trial = read_recorded_trial(bag).trial
    recorded = read_recorded_trial(some_of(bag, tmp_path / "bag", topic.__ne__, trial))
    assert recorded.moving is None and np.isnan(recorded.clearance_m).all()
    why = (
        "moving obstacles are not drawn: /moving_obstacles with their shapes is missing"
    )
    notes = [note for note in recorded.notes if "moving" in note]
    assert notes == ([why] if topic == "/moving_obstacles" else [])
    assert "class RecordedMovers" not in replay_page(recorded)


def test_walls_are_recorded_and_drawn_where_nothing_moves(world, tmp_path, open_page):
    still = replace(world, moving=())
    planners.recorded(spec_of(still, DYNABARN), tmp_path / "bag")
    recorded = read_recorded_trial(tmp_path / "bag")
    np.testing.assert_allclose(
        recorded.moving.walls.poses, wall_bodies(still.walls).poses, atol=1e-12
    )
    assert recorded.moving.places.shape[1:] == (0, 2)
    moving = recorded.moving
    times_s = recorded.times_s
    near = compute_gaps(
        moving.bodies,
        moving.walls,
        moving.at(times_s),
        recorded.poses,
        recorded.outline,
    )
    np.testing.assert_allclose(
        recorded.clearance_m, near, atol=1e-9
    )  # there are no cylinders
    write_replay([tmp_path / "bag"], [tmp_path / "trial.html", tmp_path / "trial.png"])
    page = open_page(tmp_path / "trial.html")
    assert (
        page.locator("#layer-world").count() == 1
        and page.locator("#layer-moving").count() == 0
    )
    assert page.evaluate("replay.trials[0].movers.at(1).length") == 0


def test_a_page_has_movers_in_millimeters_and_their_measures(bag):
    recorded = read_recorded_trial(bag)
    data = make_payload(recorded)
    raw = zlib.decompress(base64.b64decode(data["packed"]["zlib"]))
    kind, offset, length = data["packed"]["arrays"]["mover_places"]
    places = np.frombuffer(raw, "<i2", length, offset).reshape(
        recorded.moving.places.shape
    )
    assert kind == "Int16Array" and data["moving"]["step"] == 0.001
    apart_m = np.abs(places * 0.001 - recorded.moving.places)
    assert apart_m.max() <= 0.0005 + 1e-9
    facts = dict(list_facts(recorded))
    motion = recorded.result["motion"]
    assert facts["first contact with"] == motion["touched"]
    assert (
        facts["smallest clearance to what moves [m]"]
        == f"{motion['moving_clearance_m']:.3f}"
    )
    assert facts["time within 0.5 m of what moves [s]"] == f"{motion['near_s']:.2f}"
    assert facts["phase of moving obstacles [s]"] == f"{motion['phase_s']:.2f}"


def violet(pixels):
    """Which pixels have the color of what moves."""
    red, green, blue = np.moveaxis(pixels, 2, 0)
    return (blue > green + 12) & (red > green)


def test_pictures_and_films_show_what_moves(bag, tmp_path):
    still = some_of(
        bag,
        tmp_path / "still",
        "/moving_obstacles".__ne__,
        read_recorded_trial(bag).trial,
    )
    for camera in ("chase", "top"):
        pictures = [tmp_path / f"{camera}_{name}.png" for name in ("moving", "still")]
        for picture, source in zip(pictures, (bag, still), strict=True):
            write_replay([source], [picture], camera=camera)
        pixels = [
            np.asarray(Image.open(picture).convert("RGB"), int) for picture in pictures
        ]
        shares = [violet(picture).mean() for picture in pixels]
        assert shares[0] > 0.001 and shares[1] == 0.0


def test_a_report_has_moving_measures_and_clearances(folder, world):
    report = build_report([folder])
    data, rows = page_data(report.entries, report.trials)
    part = world_part(report.trials, range(len(report.trials)), {})
    names = [name for name, *_ in data["columns"]]
    assert {
        "moving_clearance_m",
        "time_to_collision_s",
        "near_s",
        "hit_robot_share",
        "hit_closing_mps",
    } <= set(names)
    trials = part["trials"].values()
    for row, trial, result in zip(rows, trials, read_results(folder), strict=True):
        assert (trial["phase"], trial["touched"]) == (
            result.motion.phase_s,
            result.motion.touched,
        )
        # Name, planner, world and detail come before the cells but the first.
        assert row[3 + names.index("near_s")] == pytest.approx(
            result.motion.near_s, abs=1e-4
        )
    assert report.trials[0].result.world_checksum == world.checksum
    assert part["world"]["moving"]["powers"] == 4
    for driven_trial in report.trials:
        nearest = driven_trial.track.samples[:, -1].min()
        assert nearest == pytest.approx(
            driven_trial.result.motion.moving_clearance_m, abs=0.1
        )
    assert "class MotionMovers" in report_page(report, "A title")


def test_an_overlay_shows_ways_and_what_was_hit(folder, world):
    figure = overlay([folder], WORLD)
    results = [item for item in read_results(folder) if item.motion.touched]
    assert results
    ways = collections_of(figure, LineCollection)[0].get_segments()
    assert len(ways) >= len(world.moving)
    begin = world.tracks.at(results[0].motion.phase_s)[0]
    starts = {tuple(way[0].round(6)) for way in ways}
    assert starts >= set(map(tuple, begin.round(6)))
    outlines = collections_of(figure, PolyCollection)
    paths = [path for collection in outlines for path in collection.get_paths()]
    middles = np.array([path.vertices[:-1].mean(axis=0) for path in paths])
    for item in results:
        places = world.tracks.at(item.motion.phase_s + item.scores.duration_s)[0]
        place = places[world.tracks.names.index(item.motion.touched)]
        assert np.linalg.norm(middles - place, axis=1).min() < 0.1
    texts = [item.get_text() for item in figure.legends[0].get_texts()]
    assert "moving obstacle" in texts


def test_pictures_of_an_environment_show_what_moves(monkeypatch):
    arena = {"dataset": "dynabarn60", "worlds": str(WORLD), "protocol": "dynabarn"}
    gymnasium = pytest.importorskip("gymnasium")
    env = gymnasium.make(
        "barn_eval.gym:barn/Jackal-v0", render_mode="rgb_array", **arena
    )
    env.reset(seed=0)
    first = env.render().astype(int)
    for _ in range(10):
        env.step(np.zeros(2, np.float32))
    later = env.render().astype(int)
    assert violet(first).sum() > 30 and violet(later).sum() > 30
    assert (violet(first) != violet(later)).sum() > 30
    assert (env.render() == later).all()
    monkeypatch.setattr("barn_eval.learning.drawing.TRAIL_S", 0.0)
    assert (env.render() != later).sum() > 30
    env.close()


def test_pages_move_obstacles_as_the_world_does(
    bag, folder, world, tmp_path, open_page
):
    recorded = read_recorded_trial(bag)
    phase_s = recorded.result["motion"]["phase_s"]
    other = bag.with_name(bag.name.replace("gap_", "dwa_"))
    write_replay([bag, other], [tmp_path / "two.html"])
    (tmp_path / "report.html").write_text(
        report_page(build_report([folder]), "A title"), "utf-8"
    )
    pixels = "document.getElementById('scene').toDataURL()"
    page = open_page(tmp_path / "two.html")
    for time_s in (0.0, 0.55, float(recorded.times_s[-1])):
        positions = page.evaluate(
            "(time) => Array.from(replay.trials[0].movers.at(time))", time_s
        )
        (expected,) = recorded.moving.at(np.array([time_s]))
        assert positions == pytest.approx(expected.ravel(), abs=2e-3)
    for arrangement in ("beside", "overlay"):
        page.select_option("#arrange", arrangement)
        page.evaluate("replay.player.seek(1)")
        pixel_counts = page.evaluate(pixels)
        page.click("#layer-moving")
        assert page.evaluate(pixels) != pixel_counts
        page.click("#layer-moving")
    page.click("#to-closest")
    closest_s = recorded.times_s[recorded.clearance_m.argmin()]
    closest_time_s = page.evaluate("replay.trials[0].times[replay.trials[0].closest]")
    assert closest_time_s == pytest.approx(closest_s, abs=1e-3)
    page = open_page(tmp_path / "report.html")
    page.evaluate(
        f"report.view.open(report.data.trials.findIndex((one) => one.id === '{bag.name}'))"
    )
    page.wait_for_function(f"document.body.dataset.opened === '{bag.name}'")
    for time_s in (0.0, 3.21, 77.7):
        positions = page.evaluate(
            "(time) => Array.from(report.view.movers.at(time))", time_s
        )
        expected = world.tracks.at(phase_s + time_s)[0]
        assert positions == pytest.approx(expected.ravel(), abs=5e-3)
