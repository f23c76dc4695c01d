"""Pictures and films of replays: what is drawn, what ffmpeg is sent, and what is refused."""

import os
import re
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from barn_eval.bags.recorded import read_recorded
from barn_eval.pages.replay.files import camera_frames, write_replay
from barn_sim.drawing.camera import SIZES
from barn_worlds.base.errors import ConfigError


def test_a_replay_of_too_many_bags_is_refused(bag, tmp_path):
    with pytest.raises(ConfigError, match="1 to 6 bags, got 7"):
        write_replay([bag] * 7, [tmp_path / "page.html"])


def test_a_film_without_ffmpeg_is_refused_in_one_line(bag, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigError, match="needs ffmpeg, which is not installed"):
        write_replay([bag], [tmp_path / "trial.mp4"])
    assert not (tmp_path / "trial.mp4").exists()


def test_pictures_and_animations(bag, tmp_path):
    recorded = read_recorded(bag)
    write_replay([bag], [tmp_path / "end.png"])
    with Image.open(tmp_path / "end.png") as picture:
        assert picture.size[0] > 400
        assert len(picture.convert("RGB").resize((60, 90)).getcolors(10_000)) > 20
    shares = []
    write_replay([bag], [tmp_path / "trial.gif"], frames_per_s=2.0, speed=4.0, progress=shares.append)
    assert shares == pytest.approx(np.arange(1, len(shares) + 1) / (np.ceil(recorded.times_s[-1] / 2.0) + 1))
    with Image.open(tmp_path / "trial.gif") as animation:
        # Frames that equal the one before are merged by the format.
        assert 3 <= animation.n_frames <= int(np.ceil(recorded.times_s[-1] / 2.0)) + 1
        assert animation.info["duration"] == 500
    assert [path.name for path in tmp_path.glob("*.partial")] == []
    write_replay([bag, bag], [tmp_path / "both.png"])
    with Image.open(tmp_path / "end.png") as one, Image.open(tmp_path / "both.png") as both:
        assert one.size == SIZES["top"] and both.size == (2 * one.size[0], one.size[1])
        halves = [np.asarray(both.crop((left, 0, left + one.size[0], one.size[1]))) for left in (0, one.size[0])]
        assert all((half == np.asarray(one)).all() for half in halves)
    write_replay([bag], [tmp_path / "chase.png"], camera="chase")
    with Image.open(tmp_path / "chase.png") as picture:
        assert picture.size == SIZES["chase"]
        assert len(picture.convert("RGB").getcolors(1 << 24)) > 100
    with pytest.raises(ConfigError, match="its world is not known, so a camera has nothing to see"):
        next(camera_frames(replace(recorded, scene=None), "side", [1.0], 1))


@pytest.fixture
def film_maker(tmp_path, monkeypatch):
    """A stand-in for ffmpeg, which writes how it was called and how much it was sent; it fails when told to."""
    folder = tmp_path / "programs"
    folder.mkdir()
    script = folder / "ffmpeg"
    script.write_text(
        f"#!{sys.executable}\n"
        "import os, sys\n"
        "if os.environ.get('FAIL'):\n"
        "    sys.exit('no such encoder')\n"
        "size = len(sys.stdin.buffer.read())\n"
        "open(sys.argv[-1], 'w').write(' '.join(sys.argv[1:-1]) + f'|{size}')\n"
    )
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


@pytest.mark.usefixtures("film_maker")
def test_a_film_gets_each_frame_whole_or_is_not_there(bag, tmp_path, monkeypatch):
    recorded = read_recorded(bag)
    written = tmp_path / "trial.mp4"
    write_replay([bag], [written], frames_per_s=2.0, speed=4.0)
    called, sent = written.read_text().split("|")
    width, height = (int(text) for text in re.search(r"-s (\d+)x(\d+) -r 2 ", called).groups())
    assert width % 2 == height % 2 == 0
    assert int(sent) == 3 * width * height * (int(np.ceil(recorded.times_s[-1] / 2.0)) + 1)
    written.unlink()
    monkeypatch.setenv("FAIL", "1")
    with pytest.raises(ConfigError, match=r"trial.mp4: ffmpeg failed: no such encoder$"):
        write_replay([bag], [written], frames_per_s=2.0, speed=4.0)
    assert list(tmp_path.glob("trial.mp4*")) == []


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg on the path")
def test_a_film(bag, tmp_path):
    write_replay([bag], [tmp_path / "trial.mp4"], frames_per_s=5.0, speed=4.0)
    assert (tmp_path / "trial.mp4").read_bytes()[4:8] == b"ftyp"
