"""Files that were made to hurt.

Every command refuses them in one short line, and shows their names as text.
"""

import re
import shutil

import pytest
from reproduce_work import write_invented
from text_tables import answers_of

from barn_eval.api.results import Results
from barn_eval.results.rows import seal_line, unseal_line
from barn_eval.trials.run_config import PlannerChoice, RunConfig

GAP = RunConfig(worlds="0,9", planners=(PlannerChoice("gap"), PlannerChoice("dwa")))
TAG = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    out = tmp_path_factory.mktemp("hostile") / "out"
    write_invented(out, GAP)
    return out


# What a run file has, where {x*5000} stands for as many of a letter and ; for the end
# of a line, and what is said.
CAMPAIGN = r"""
seed: 0x{f*5000}
    c.yaml: seed must be
seed: 1{0*400}
    c.yaml: seed must be
seed: !!python/object/apply:os.system [true]
    c.yaml: not YAML:
3: 4
    c.yaml: unknown key 3
execution: {worker: 2}
    c.yaml: execution: unknown key 'worker'; did you mean 'workers'?
? 0x{f*5000};: 4
    c.yaml: unknown key
? [1];: 4
    c.yaml:
dataset: {x*5000}
    'xxx
planners: [{name: dwa, overrides: {3: 4}}]
    c.yaml: planners: overrides[3] must be
out: 5
    c.yaml: out must name a folder for the results, got 5
out: "a\0b"
    out 'a\x00b': a path cannot contain a NUL
planners: [{x*5000}]
    planner 'xxx
"""


def repeat(match):
    return match[1] * int(match[2])


@pytest.mark.parametrize("text, words", answers_of(CAMPAIGN))
def test_a_campaign_file(rejected, tmp_path, text, words):
    text = re.sub(r"\{(.)\*(\d+)\}", repeat, text).replace(";", "\n")
    out = "" if "out:" in text else "out: out\n"
    (tmp_path / "c.yaml").write_text(f"schema_version: 1\n{out}{text}\n")
    assert rejected("campaign", "c.yaml").startswith(f"error: {words}")
    assert not (tmp_path / "out").exists()


def test_a_setting_like_a_date_is_a_text(rejected):
    error = rejected("run", "--set", "dwa.max_speed_mps=2001-13-99")
    assert "dwa.max_speed_mps must be a number, got '2001-13-99'" in error


@pytest.mark.parametrize("value", ["!!int x", "[" * 2000, "9" * 5000, "\ud800"])
def test_a_setting(rejected, value):
    assert rejected("run", "--set", f"dwa.max_speed_mps={value}").startswith(
        "error: --set 'dwa.max_speed_mps="
    )


ROWS = {
    "NaN": lambda row: row.replace('"contact_s":0.0', '"contact_s":NaN'),
    "10^400 as text of a float": lambda row: row.replace(
        '"contact_s":0.0', '"contact_s":1' + "0" * 400
    ),
    "list": lambda row: f"[{row}]",
    "mapping for a number": lambda row: row.replace('"world":0', '"world":{"a":0}'),
    "long line": lambda row: row.replace(
        '"detail":""', f'"detail":"{"x" * 2_000_000}"'
    ),
}


@pytest.mark.parametrize("case", ROWS)
def test_a_row(rejected, good, tmp_path, case):
    out = shutil.copytree(good, tmp_path / "out")
    first = (out / "results.jsonl").read_text().splitlines()[0]
    (out / "results.jsonl").write_text(
        seal_line(ROWS[case](unseal_line(first, case))) + "\n"
    )
    for command in (
        ("report", out),
        ("compare", f"{out}:gap", f"{out}:dwa"),
        ("leaderboard", out),
    ):
        assert rejected(*command).startswith(f"error: {out}/results.jsonl, line 1: ")


def test_names_of_folders_are_text_on_every_page(good, tmp_path, command):
    folders = [tmp_path / f"{TAG}{number}" for number in range(2)]
    for folder in folders:
        shutil.copytree(good, folder)
    for verb in ("report", "leaderboard"):
        page = tmp_path / f"{verb}.html"
        code, _, err = command(
            verb,
            *folders,
            "--out",
            page,
            *(["--no-assets"] if verb == "report" else []),
        )
        assert code == 0, err
        assert "<img src=x" not in page.read_text()
        assert "&lt;img src=x onerror=alert(1)&gt;" in page.read_text()
    assert "<img src=x" not in Results(folders[0])._repr_html_()
