"""`barn ab`: what BASE and HEAD may be, what is driven again, and what it says."""

import json

import pytest
from refusals import refused
from text_tables import rows_of

from barn_eval.running.reporting import Reporter
from barn_eval.studies import ab as studied
from barn_eval.studies.ab import AbResult, ab
from barn_worlds.base.errors import BarnError

OPTIONS = {"worlds": "0:300:50", "workers": 1, "engine": "inline"}


def side(text, command="", base="dwa"):
    return studied.read_side(text, base, command, {"out": studied.Path("out")})


@pytest.fixture
def workspace(tmp_path):
    install = tmp_path / "ws" / "install"
    (install / "lib").mkdir(parents=True)
    (install / "setup.bash").write_text("true\n")
    (install / "lib" / "plugin.so").write_bytes(b"one")
    return install.parent


def test_a_planner_of_the_suite_is_given_with_its_settings():
    (planner,) = side(
        "dwa:fast_dwa,dwa.path_weight=0.6,dwa.sim_time_s=1"
    ).config.planners
    assert (planner.name, planner.preset) == ("dwa", "fast_dwa")
    assert planner.overrides == {"dwa.path_weight": 0.6, "dwa.sim_time_s": 1}


def test_a_workspace_is_sourced_and_known_by_what_is_installed(workspace):
    first = side(str(workspace), "ros2 run my_nav host")
    (planner,) = first.config.planners
    assert (
        planner.command
        == f"bash -c '. {workspace}/install/setup.bash && exec ros2 run my_nav host'"
    )
    assert first.config.mode == "ros"
    assert (
        side(str(workspace / "install" / "setup.bash"), "ros2 run my_nav host").out
        == first.out
    )
    (workspace / "install" / "lib" / "plugin.so").write_bytes(b"two")
    assert side(str(workspace), "ros2 run my_nav host").out != first.out


def test_a_parameter_file_wins_and_is_known_by_content(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("a: 1\n")
    command = "run --ros-args --params-file nav.yaml"
    first = side(str(file), command)
    assert first.config.planners[0].command == f"{command} --params-file {file}"
    (named,) = side(str(file), f"mine={command}").config.planners
    assert (named.name, named.command) == ("mine", first.config.planners[0].command)
    file.write_text("a: 2\n")
    assert side(str(file), command).out != first.out


def test_both_commands_drive_as_base_with_equal_seeds():
    base, head = (
        side(f"python {name}.py", base="python base.py") for name in ("base", "head")
    )
    for request in (base, head):
        assert request.config.planners[0].name == "base"
    assert base.out != head.out


def test_a_file_of_a_run_is_a_side(tmp_path):
    file = tmp_path / "run.yaml"
    file.write_text(
        "schema_version: 1\nplanners: [{name: gap, overrides: {max_speed_mps: 0.4}}]\n"
    )
    assert side(str(file)).config.planners[0].overrides == {"max_speed_mps": 0.4}


NO_SIDES = """
no_such_program --fast |        | is not a workspace, file, planner of the suite or command
dwa,dwa.path_weight    |        | must be key=value
.                      | run me | no setup.bash
ws                     |        | a workspace needs --planner-command
"""


@pytest.mark.parametrize("text, command, words", rows_of(NO_SIDES))
def test_what_is_nothing_is_refused_in_one_line(
    text, command, words, workspace, monkeypatch
):
    monkeypatch.chdir(workspace.parent)
    with refused(words, BarnError):
        side(text, command)


def test_equal_sides_are_refused(tmp_path):
    with refused("BASE and HEAD are the same", BarnError):
        ab("gap", "gap,max_speed_mps=0.5", "", OPTIONS | {"out": tmp_path}, Reporter())


def test_unchanged_sides_are_not_driven_again(command, tmp_path):
    words = ("--worlds", "0:300:20", "--run", "engine=inline", "--out", "ab")
    code, out, err = command("ab gap,max_speed_mps=0.9 gap,max_speed_mps=0.4", *words)
    assert code == 4
    assert out.startswith("**HEAD is worse than BASE**, by the challenge metric: ")
    assert "| challenge metric (of 0.5) | " in out
    code, out, err = command(
        "ab gap,max_speed_mps=0.4 gap,max_speed_mps=0.9", *words, "--json"
    )
    content = json.loads(out)
    assert (code, content["decision"]) == (0, "better")
    assert content["worlds"] < content["planned"] == 15
    assert err.count("trials are already there") == 2 and "success in" not in err
    folders = {path.name for path in (tmp_path / "ab").iterdir()}
    assert {content["base"], content["head"]} == {f"ab/{name}" for name in folders}


def test_a_verdict_tells_how_far_it_went(tmp_path):
    conclusion = ab(
        "gap", "gap,margin_m=0.031", "", OPTIONS | {"out": tmp_path}, Reporter()
    )
    assert isinstance(conclusion, AbResult)
    assert conclusion.decision in ("futile", "open")
    text = conclusion.markdown()
    assert f"after {conclusion.worlds} of 6 worlds" in text
    assert "difference is significant" in text
    assert f"\nOnly {conclusion.worlds} worlds: " in text
