"""Pictures and films of replays, and trials drawn over their world.

What is drawn, sent to ffmpeg, and refused.
"""

import os
import re
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import to_hex
from PIL import Image
from refusals import refused
from report_work import EVIL
from text_tables import answers_of

import barn_eval as barn
from barn_eval.analysis.entries import read_entries
from barn_eval.analysis.planners import assign_colors
from barn_eval.pages.replay.files import draw_views, write_replay
from barn_eval.pages.report.maps import overlay, select_trials
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.tracks import parse_track_line
from barn_sim.drawing.camera import SIZES
from barn_worlds.datasets.dataset import open_dataset


def test_a_replay_of_too_many_bags_is_refused(bag, tmp_path):
    with refused("1 to 6 bags, got 7"):
        write_replay([bag] * 7, [tmp_path / "page.html"])


def test_a_film_without_ffmpeg_is_refused_in_one_line(bag, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with refused("needs ffmpeg, which is not installed"):
        write_replay([bag], [tmp_path / "trial.mp4"])
    assert not (tmp_path / "trial.mp4").exists()


def count_frames(recorded):
    """Return the frames of a film at two a second and four times the speed."""
    return int(np.ceil(recorded.times_s[-1] / 2.0)) + 1


def test_pictures_and_animations(bag, tmp_path):
    recorded = read_recorded_trial(bag)
    write_replay([bag], [tmp_path / "end.png"])
    with Image.open(tmp_path / "end.png") as picture:
        assert len(picture.convert("RGB").resize((60, 90)).getcolors(10_000)) > 20
    shares = []
    options = {"frames_per_s": 2.0, "speed": 4.0, "progress": shares.append}
    write_replay([bag], [tmp_path / "trial.gif"], **options)
    frames = count_frames(recorded)
    assert shares == pytest.approx(np.arange(1, len(shares) + 1) / frames)
    with Image.open(tmp_path / "trial.gif") as animation:
        # Frames that equal the one before are merged by the format.
        assert 3 <= animation.n_frames <= frames
        assert animation.info["duration"] == 500
    assert [path.name for path in tmp_path.glob("*.partial")] == []
    write_replay([bag, bag], [tmp_path / "both.png"])
    image, both = (
        np.asarray(Image.open(tmp_path / name)) for name in ("end.png", "both.png")
    )
    height, width, _ = image.shape
    assert (width, height) == SIZES["top"]
    assert both.shape == (height, 2 * width, 3)
    for half in np.split(both, 2, axis=1):
        assert (half == image).all()
    write_replay([bag], [tmp_path / "chase.png"], camera="chase")
    with Image.open(tmp_path / "chase.png") as picture:
        assert picture.size == SIZES["chase"]
        assert len(picture.convert("RGB").getcolors(1 << 24)) > 100
    with refused("its world is unknown, so a camera cannot draw it"):
        next(draw_views(replace(recorded, scene=None), "side", [1.0], 1))


# A stand-in for ffmpeg, which writes how it was called and how much it was sent; it
# fails when told to.
FILM_MAKER = f"""#!{sys.executable}
import os, sys
if os.environ.get("FAIL"):
    sys.exit("no such encoder")
size = len(sys.stdin.buffer.read())
open(sys.argv[-1], "w").write(" ".join(sys.argv[1:-1]) + f"|{{size}}")
"""


def test_a_film_gets_each_frame_whole_or_is_not_there(bag, tmp_path, monkeypatch):
    recorded = read_recorded_trial(bag)
    written = tmp_path / "trial.mp4"
    (tmp_path / "ffmpeg").write_text(FILM_MAKER)
    (tmp_path / "ffmpeg").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    write_replay([bag], [written], frames_per_s=2.0, speed=4.0)
    called, sent = written.read_text().split("|")
    size = re.search(r"-s (\d+)x(\d+) -r 2 ", called)
    width, height = map(int, size.groups())
    assert width % 2 == height % 2 == 0
    assert int(sent) == 3 * width * height * count_frames(recorded)
    written.unlink()
    monkeypatch.setenv("FAIL", "1")
    with refused(r"trial.mp4: ffmpeg failed: no such encoder$"):
        write_replay([bag], [written], frames_per_s=2.0, speed=4.0)
    assert list(tmp_path.glob("trial.mp4*")) == []


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg on the path")
def test_a_film(bag, tmp_path):
    write_replay([bag], [tmp_path / "trial.mp4"], frames_per_s=5.0, speed=4.0)
    assert (tmp_path / "trial.mp4").read_bytes()[4:8] == b"ftyp"


def collections_of(figure, kind):
    return [
        collection
        for collection in figure.axes[0].collections
        if type(collection) is kind
    ]


def test_each_trial_is_drawn_in_its_planners_color(folder):
    trials, _ = select_trials(read_entries([folder]), 0, (), "")
    assert sorted(trial.result.planner for trial in trials) == ["dwa", "gap", "gap"]
    figure = overlay([folder], 0)
    lines = collections_of(figure, LineCollection)
    assert len(lines) == 3
    shades = dict(zip(("gap", "dwa"), assign_colors(["gap", "dwa"]), strict=True))
    for line, trial in zip(lines, trials, strict=True):
        assert to_hex(line.get_color()[0]) == shades[trial.result.planner]
        text = trial.entry.source.tracks[trial.result.trial_id]
        places = parse_track_line(text, "")[1].samples[:, 1:3]
        drawn = np.array(line.get_segments())[:, 0]
        np.testing.assert_array_equal(drawn, places[:-1])
        assert np.isfinite(places).all()
    paths = [
        path
        for outlines in collections_of(figure, PolyCollection)
        for path in outlines.get_paths()
    ]
    assert len(paths) == 6
    ends = [trial.track.samples[index, 1:3] for trial in trials for index in (0, -1)]
    middles = [path.vertices[:4].mean(axis=0) for path in paths]
    assert np.allclose(middles, ends, atol=0.05)
    world = open_dataset("barn300").load(0)
    stands = [
        len(trial.get_offsets()) for trial in collections_of(figure, EllipseCollection)
    ]
    assert stands == [len(world.containment_m), len(world.obstacles_m)]
    texts = [trial.get_text() for trial in figure.legends[0].get_texts()]
    counts = ["gap\n2 success", "DWA\n1 success"]
    assert texts == [*counts, "start", "goal", "robot at both ends"]


def test_colors_by_speed_have_a_scale(folder):
    figure = overlay([folder], 0, by="speed", planners=["dwa"])
    (line,) = collections_of(figure, LineCollection)
    assert line.get_array().max() > 0.2
    fastest = line.get_array().max()
    assert line.get_clim() == (0.0, pytest.approx(max(0.5, fastest)))
    assert figure.axes[1].get_ylabel() == "speed [m/s]"


MISTAKES = """
{world_number: 99}
    world 99: no trial; there are trials of 0, 1, 2, 3, 4, 5, 6, 7
{world_number: 1}
    world 1: its trials have no tracks
{world_number: 0, outcome: collision}
    world 0: none of its trials is of this kind
{world_number: 0, outcome: colision}
    outcome 'colision': must be one of .*did you mean 'collision'
{world_number: 0, planners: [dwaa]}
    planner 'dwaa': no trial here; did you mean 'dwa'.* dwa, gap
{world_number: 0, by: sped}
    by: must be one of planner, speed, got 'sped'; did you mean 'speed'
"""


@pytest.mark.parametrize("arguments, reason", answers_of(MISTAKES))
def test_what_is_not_there_is_told_in_one_line(folder, arguments, reason):
    with refused(reason):
        overlay([folder], **yaml.safe_load(arguments))


def test_the_command_and_python_draw_the_same(folder, tmp_path, succeed, rejected):
    for out in ("", "--out speed.svg --by speed --planner gap"):
        succeed(f"show 0 --trials {folder} {out}")
    barn.load(folder).overlay(0).save(tmp_path / "python.png")
    with Image.open("trials_w0000.png") as first, Image.open("python.png") as other:
        assert first.size == other.size
        assert np.array_equal(np.asarray(first), np.asarray(other))
    assert EVIL not in (tmp_path / "speed.svg").read_text()
    trials = f"--trials {folder}"
    for wrong, message in (
        (trials, "Missing argument 'WORLDS'"),
        ("3 --by speed", "--by needs --trials"),
        (
            f"world.npy {trials}",
            "--trials needs the number of a world, got 'world.npy'",
        ),
        (f"0 {trials} --out a.gif", "a.gif: must end in .png, .svg or .pdf"),
    ):
        assert message in rejected(f"show {wrong}")
