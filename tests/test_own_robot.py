"""The tutorial on one's own robot, followed to the letter."""

import re
import shlex
from pathlib import Path

import pytest

from barn_eval.commands.main import main

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorials" / "own_robot.md"


def test_the_tutorial_works_as_it_is_written(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text("utf-8")
    (robot,) = re.findall(r"(?ms)^```yaml\n(.*?)^```", text)
    Path("mine.yaml").write_text(robot)
    commands = [shlex.split(line) for line in re.findall(r"(?m)^    (barn .*)$", text)]
    assert len(commands) == 9
    for words in commands:
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        assert ended.value.code in (0, None), (words, capfd.readouterr().err)
    said = capfd.readouterr().out
    assert "robot mine, " in said
    for made in ("mine.png", "mine.npz", "out/mine_dwa.html", "out/mine/results.parquet"):
        assert Path(made).stat().st_size > 1000
    for trial in re.findall(r"(?m)^ *dwa_w0000_r00 +(\w+)", said):
        assert trial == "success"
