"""`barn submit` and `barn verify`: what was made honestly holds anywhere.

What was forged or is hostile does not.
"""

import hashlib
import json
import shutil
import zipfile
from functools import partial

import pytest
import yaml
from forgery import forge, replace_text, won
from planners import run_inline
from waiting import ROOT, run_python

import barn_eval as barn
from barn_eval.analysis.leaderboard import make_boards
from barn_eval.results.rows import seal_line, unseal_line
from barn_eval.running import direct
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.verification.check import check_folder
from barn_eval.verification.submission import submit
from barn_worlds.base.errors import ExitCode

DIGEST = "sha256:" + "ab" * 32


@pytest.fixture(scope="module")
def submitted(run, tmp_path_factory):
    """The file of a folder with one trial."""
    path = tmp_path_factory.mktemp("submitted") / "gap.barn.zip"
    submit(run, path, DIGEST)
    return path


def rewritten(submitted, path, change, **changes):
    """Write a submission again with its files changed, and what is said about them.

    Its hashes are right.
    """
    with zipfile.ZipFile(submitted) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    content = json.loads(files.pop("submission.json"))
    change(files)
    content["files"] = {
        name: hashlib.sha256(data).hexdigest() for name, data in files.items()
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("submission.json", json.dumps(content | changes))
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def test_what_was_submitted_holds_and_is_a_folder_again(
    run, submitted, command, printed, tmp_path
):
    kept = tmp_path / "kept"
    content = printed(f"verify {submitted} --out {kept}")
    expected = {"holds": True, "problems": [], "driven": 1, "planners": ["gap"]}
    expected |= {"protocol": "challenge", "container": DIGEST}
    assert content | expected == content
    assert (kept / "results.csv").read_bytes() == (run / "results.csv").read_bytes()
    assert check_folder(kept).problems == []
    assert "kept only claims versions" in make_boards([kept])[0].notes[-1]
    said = "1 of 1 rows, 1 tracks, 0 bags, 1 driven again\nholds\n"
    assert command(f"verify {submitted}")[1].endswith(said)


def test_equal_results_give_equal_bytes(run, submitted, tmp_path):
    submit(run, tmp_path / "again.zip", DIGEST)
    assert (tmp_path / "again.zip").read_bytes() == submitted.read_bytes()


def forged(change, folder):
    """Return what makes of a submission's files those of a folder, which is made of
    them and then forged.
    """

    def apply(files):
        folder.mkdir()
        for name, data in files.items():
            (folder / name).write_bytes(data)
        change(folder)
        files |= {name: (folder / name).read_bytes() for name in list(files)}

    return apply


@pytest.mark.parametrize(
    "change, words",
    [
        (
            lambda folder: forge(folder, scores__challenge=7.0),
            "scores.challenge is 7.0 in the row",
        ),
        (
            lambda folder: forge(folder, **won(barn.load(folder).trials[0], 18.0)),
            "traversal_time_s is 18.0 in the row",
        ),
        (
            lambda folder: (folder / "commands.jsonl").write_text(""),
            "1 trials: not driven again, because their commands",
        ),
        (
            lambda folder: replace_text(folder / "commands.jsonl", '"eJ', '"eK'),
            "damaged or edited: its crc32 is",
        ),
    ],
)
def test_what_was_forged_does_not_hold_and_is_not_unpacked(
    submitted, command, tmp_path, change, words
):
    path = rewritten(
        submitted, tmp_path / "again.barn.zip", forged(change, tmp_path / "forged")
    )
    code, out, err = command(f"verify {path} --out {tmp_path}/kept")
    assert (code, out.splitlines()[-1]) == (1, "does not hold")
    assert not (tmp_path / "kept").exists()
    assert words in err


def drive_as_dwa(out, monkeypatch, planners):
    """Drive trials in which gap takes the place of DWA, and submit them."""
    make = direct.make_planner
    with monkeypatch.context() as patch:
        patch.setattr(direct, "make_planner", lambda *_: make("gap"))
        folder = run_inline("0", planners, CHALLENGE, out=out).folder
    path = out.with_suffix(".barn.zip")
    submit(folder, path)
    return folder, path


def test_another_planner_under_the_name_of_one_does_not_hold(
    tmp_path, monkeypatch, command
):
    folder, path = drive_as_dwa(tmp_path / "alone", monkeypatch, ["dwa"])
    assert check_folder(folder).problems == []
    code, out, err = command(f"verify {path}")
    assert (code, out.splitlines()[-1]) == (1, "does not hold")
    assert "dwa_w0000_r00: dwa drives otherwise: " in err
    assert "claimed: " in out


def test_equal_commands_of_two_planners_are_named(tmp_path, monkeypatch, command):
    folder, path = drive_as_dwa(tmp_path / "twins", monkeypatch, ["gap", "dwa"])
    report = check_folder(folder)
    words = "dwa and gap have equal commands in 1 trials"
    assert (report.problems, report.notes) == ([], [f"{folder}: {words}"])
    (board,) = make_boards([folder])
    assert f"DWA{words.removeprefix('dwa')}." in board.notes
    assert words in command(f"verify {path}")[2]


def test_a_row_of_a_planner_that_was_not_run_is_named(submitted, tmp_path, command):
    def change(files):
        (line,) = files["results.jsonl"].decode().splitlines()
        row = json.loads(unseal_line(line, "line"))
        row |= {"planner": "other", "trial_id": "other_w0000_r00"}
        files["results.jsonl"] += f"{seal_line(json.dumps(row))}\n".encode()

    path = rewritten(submitted, tmp_path / "forged.zip", change)
    code, _, err = command(f"verify {path}")
    assert code == 1
    assert "other_w0000_r00 is not a trial of this run" in err


# What is done to the files of a submission or to its content, and what is said.
NO_SUBMISSIONS = """
- {add: ../evil.txt, words: "'../evil.txt', which is not part of a submission"}
- {add: /etc/evil, words: "holds '/etc/evil', which is not part"}
- {add: parameters/../../a, words: which is not part of a submission}
- {add: worlds.npz, size: 16777216, words: unpacks to 16777216}
- {remove: tracks.jsonl, words: 'not a submission: no tracks.jsonl'}
- {content: {schema_version: 2}, words: schema_version must be 1}
- {content: {files: {}}, words: its list of files does not match the archive}
- {content: {container: latest}, words: "container 'latest' is not a digest"}
- {old: '"barn300"', new: '"/etc"', words: dataset}
- {old: '"barn_sim": "', new: '"barn_sim": "9.', words: "was made with barn_sim '9."}
"""


@pytest.mark.parametrize("case", yaml.safe_load(NO_SUBMISSIONS))
def test_what_is_no_submission_is_refused_in_one_line(
    submitted, rejected, tmp_path, case
):
    def change(files):
        if "add" in case:
            files[case["add"]] = bytes(case.get("size", 0))
        files.pop(case.get("remove"), None)
        text = files["run.json"].decode()
        text = text.replace(case.get("old", ""), case.get("new", ""))
        files["run.json"] = text.encode()

    content = case.get("content", {})
    path = rewritten(submitted, tmp_path / "again.barn.zip", change, **content)
    assert case["words"] in rejected(f"verify {path}", ends=ExitCode.FINDINGS)


def test_a_file_that_is_cut_off_or_no_zip_is_refused_in_one_line(
    submitted, rejected, tmp_path
):
    for content in (submitted.read_bytes()[:-100], b"PK\x05\x06", b"", b"rows"):
        (tmp_path / "bad.zip").write_bytes(content)
        error = rejected("verify bad.zip", ends=ExitCode.FINDINGS)
        assert "is not a submission, or is damaged" in error


def test_what_cannot_be_checked_is_not_submitted(rejected, tmp_path, monkeypatch):
    monkeypatch.setattr(direct, "Simulator", None)
    with pytest.raises(barn.BarnError):
        run_inline("0", out=tmp_path / "lost")
    error = rejected("submit lost", ends=ExitCode.FINDINGS)
    assert "cannot be submitted: 1 trials: not driven again" in error


def test_what_does_not_hold_or_is_not_finished_is_not_submitted(
    run, rejected, tmp_path
):
    folder = shutil.copytree(run, tmp_path / "out")
    forge(folder, scores__challenge=7.0)
    findings = partial(rejected, f"submit {folder}", ends=ExitCode.FINDINGS)
    assert "cannot be submitted: " in findings()
    (folder / "results.jsonl").write_text("")
    assert "has 0 of 1 trials" in findings()
    assert "container 'me'" in rejected(f"submit {run} --container me")


def test_the_template_board_has_a_page_before_its_first_submission(tmp_path):
    board = shutil.copytree(ROOT / "examples" / "leaderboard", tmp_path / "board")
    run_python(board / "build.py")
    assert "No submission" in (board / "site" / "index.html").read_text()


def test_the_template_board_names_what_does_not_hold(submitted, tmp_path):
    board = shutil.copytree(ROOT / "examples" / "leaderboard", tmp_path / "board")
    rules = json.loads((board / "board.json").read_text())
    (board / "board.json").write_text(json.dumps(rules | {"worlds": "0", "seed": 5}))
    shutil.copy(submitted, board / "submissions" / "honest.barn.zip")
    changes = {
        "score": lambda folder: forge(folder, scores__challenge=7.0),
        "seed": lambda folder: replace_text(
            folder / "run.json", '"seed": 5', '"seed": 6'
        ),
    }
    for name, change in changes.items():
        rewritten(
            submitted,
            board / "submissions" / f"x_{name}.barn.zip",
            forged(change, tmp_path / name),
        )
    done = run_python(board / "build.py", check=False)
    reports = dict(line.split(".barn.zip: ", 1) for line in done.stdout.splitlines())
    assert done.returncode == 1
    assert [name for name, report in reports.items() if report == "holds"] == ["honest"]
    assert reports.keys() == {"honest", *(f"x_{name}" for name in changes)}
    assert "gap" in (board / "site" / "index.html").read_text()
