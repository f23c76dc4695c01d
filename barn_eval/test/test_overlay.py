"""Trials drawn over their world: which are chosen, what is drawn of them, and what is refused."""

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import to_hex
from PIL import Image
from report_work import EVIL

import barn_eval as barn
from barn_eval.analysis.planners import colours
from barn_eval.analysis.sources import read_entries
from barn_eval.experiments.track import from_track_line
from barn_eval.pages.report.maps import choose, overlay
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import open_dataset


def drawn(figure, kind):
    return [one for one in figure.axes[0].collections if type(one) is kind]


def test_each_trial_is_drawn_where_it_drove_in_the_colour_of_its_planner(folder):
    chosen, _ = choose(read_entries([folder]), 0, (), "")
    assert sorted(one.result.planner for one in chosen) == ["dwa", "gap", "gap"]
    figure = overlay([folder], 0)
    lines = drawn(figure, LineCollection)
    assert len(lines) == 3
    shades = dict(zip(("gap", "dwa"), colours(["gap", "dwa"]), strict=True))
    for line, one in zip(lines, chosen, strict=True):
        assert to_hex(line.get_color()[0]).upper() == shades[one.result.planner]
        kept = from_track_line(one.entry.source.tracks[one.result.trial_id], "")[1].samples
        assert np.array(line.get_segments())[:, 0].tolist() == kept[:-1, 1:3].tolist()
        assert np.isfinite(kept[:, 1:3]).all()
    outlines = [path.vertices for one in drawn(figure, PolyCollection) for path in one.get_paths()]
    assert len(outlines) == 6
    ends = [one.track.samples[index, 1:3] for one in chosen for index in (0, -1)]
    middles = [outline[:4].mean(axis=0) for outline in outlines]
    assert np.allclose(middles, ends, atol=0.05)
    world = open_dataset("barn300").load(0)
    stands = [len(one.get_offsets()) for one in drawn(figure, EllipseCollection)]
    assert stands == [len(world.containment_m), len(world.obstacles_m)]
    texts = [one.get_text() for one in figure.legends[0].get_texts()]
    assert texts == ["gap\n2 success", "DWA\n1 success", "start", "goal", "robot at both ends"]


def test_colours_by_speed_have_a_scale(folder):
    figure = overlay([folder], 0, by="speed", planners=["dwa"])
    (line,) = drawn(figure, LineCollection)
    assert line.get_array().max() > 0.2
    assert line.get_clim() == (0.0, pytest.approx(max(0.5, line.get_array().max())))
    assert figure.axes[1].get_ylabel() == "speed [m/s]"


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"world": 99}, "world 99: no trial of it; there are trials of 0, 1, 2, 3, 4, 5, 6, 7"),
        ({"world": 1}, "world 1: its trials have no tracks"),
        ({"world": 0, "outcome": "collision"}, "world 0: no trial of it is of this kind"),
        ({"world": 0, "outcome": "colision"}, "outcome 'colision': must be one of .*did you mean 'collision'"),
        ({"world": 0, "planners": ["dwaa"]}, "planner 'dwaa': has no trial here; did you mean 'dwa'.* dwa, gap"),
        ({"world": 0, "by": "sped"}, "by: must be one of planner, speed, got 'sped'; did you mean 'speed'"),
    ],
)
def test_what_is_not_there_is_told_in_one_line(folder, arguments, reason):
    with pytest.raises(ConfigError, match=reason):
        overlay([folder], **arguments)


def test_the_command_and_python_draw_the_same(folder, tmp_path, command, rejected):
    for out in ([], ["--out", "speed.svg", "--by", "speed", "--planner", "gap"]):
        assert command("show", 0, "--trials", folder, *out)[0] == 0
    barn.load(folder).overlay(0).save(tmp_path / "python.png")
    with Image.open("trials_w0000.png") as one, Image.open("python.png") as other:
        assert one.size == other.size
        assert np.array_equal(np.asarray(one), np.asarray(other))
    assert EVIL not in (tmp_path / "speed.svg").read_text()
    for wrong, told in (
        (["--trials", str(folder)], "Missing argument 'WORLDS'"),
        (["3", "--by", "speed"], "--by needs --trials"),
        (["world.npy", "--trials", str(folder)], "--trials needs the number of a world, got 'world.npy'"),
        (["0", "--trials", str(folder), "--out", "a.gif"], "a.gif: must end in .png, .svg or .pdf"),
    ):
        assert told in rejected("show", *wrong)
