"""Files of results that are damaged or altered behind the suite's back."""

import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from barn_eval.results.rows import RowFile, seal_line, unseal_line, write_tables
from fault_cases.campaigns import campaign, resume, run_undisturbed
from fault_cases.files import FAMILY
from fault_cases.kit import Lab, add, add_all, case, hold


def _copy_finished(lab: Lab) -> Path:
    shutil.copytree(run_undisturbed(), lab.out)
    return lab.out


def _copy_unfinished(lab: Lab) -> Path:
    """Leave a campaign of seven rows."""
    out = _copy_finished(lab)
    for name in ("results.jsonl", "tracks.jsonl"):
        lines = (out / name).read_bytes().splitlines(keepends=True)
        (out / name).write_bytes(b"".join(lines[:7]))
    for path in out.glob("*.parquet"):
        path.unlink()
        path.with_suffix(".csv").unlink()
    # tracks are in the order of the plan once a campaign is complete
    tracks = (run_undisturbed() / "tracks.jsonl").read_text().splitlines()
    rows = [json.loads(line)["trial_id"] for line in tracks[:7]]
    results = (run_undisturbed() / "results.jsonl").read_text().splitlines()
    texts = {json.loads(line)["trial_id"]: line for line in results}
    row_lines = [f"{texts[name]}\n" for name in rows]
    (out / "results.jsonl").write_text("".join(row_lines))
    return out


def _torn(lab: Lab, name: str) -> str:
    out = _copy_unfinished(lab)
    path = out / name
    if name != "results.jsonl":  # a row comes after its track and its commands
        last = json.loads(path.read_text().splitlines()[-1])["trial_id"]
        rows = (out / "results.jsonl").read_text().splitlines(keepends=True)
        kept = [row for row in rows if json.loads(row)["trial_id"] != last]
        (out / "results.jsonl").write_text("".join(kept))
    path.write_bytes(path.read_bytes()[:-40])
    return resume(lab)


for _name, _file in (
    ("row-cut-off", "results.jsonl"),
    ("track-cut-off", "tracks.jsonl"),
    ("commands-cut-off", "commands.jsonl"),
):
    add(
        FAMILY,
        _name,
        f"The last line of {_file} is cut off, as a crash of the machine leaves it, and the campaign is run again.",
        "The trial is run again; the tables are the undisturbed ones to the byte.",
        _torn,
        _file,
    )


def _contents(out: Path) -> dict[str, bytes]:
    """Return the content of each file but the lock."""
    return {
        path.name: path.read_bytes()
        for path in out.iterdir()
        if path.is_file() and path.name != ".lock"
    }


def _expect_refusal(
    lab: Lab, alter: Callable[[Path], object], words: str, *, unfinished: bool = True
) -> str:
    """Alter a folder.

    Both resuming and checking must refuse it and leave it as it is.
    """
    out = _copy_unfinished(lab) if unfinished else _copy_finished(lab)
    alter(out)
    before = _contents(out)
    refusal = lab.expect_refusal(*campaign(lab))
    checked = lab.barn("check", out, code=1).err
    hold(words in refusal or words in checked, f"{refusal} | {checked}")
    hold(before == _contents(out), "files were changed")
    return refusal


def _edit(name: str, old: str, new: str) -> Callable[[Path], object]:
    def edit(out: Path) -> None:
        text = (out / name).read_text()
        hold(old in text, f"{name} has no {old}")
        (out / name).write_text(text.replace(old, new, 1))

    return edit


def _insert(name: str, line: bytes) -> Callable[[Path], object]:
    def insert(out: Path) -> None:
        lines = (out / name).read_bytes().splitlines(keepends=True)
        lines.insert(3, line + b"\n")
        (out / name).write_bytes(b"".join(lines))

    return insert


def _double(out: Path) -> None:
    lines = (out / "results.jsonl").read_bytes().splitlines(keepends=True)
    (out / "results.jsonl").write_bytes(b"".join([*lines, lines[0]]))


_MUST = "Resuming refuses it in one line with file and line; `barn check` names it as well; nothing is changed."
_ALTERED = (
    (
        "garbage-line",
        "Bytes that are no text stand between two rows.",
        _insert("results.jsonl", b"\xff\xfe\0\1"),
        "line 4",
    ),
    (
        "altered-row",
        "A row is edited.",
        _edit("results.jsonl", '"campaign_seed":5', '"campaign_seed":6'),
        "crc32",
    ),
    (
        "altered-score",
        "A score is edited.",
        _edit("results.jsonl", '"success":false', '"success":true '),
        "crc32",
    ),
    ("doubled-row", "A row stands there twice.", _double, "is listed twice"),
    (
        "altered-seed",
        "The seed in run.json is edited.",
        _edit("run.json", '"seed": 5', '"seed": 6'),
        "seed",
    ),
    (
        "altered-protocol",
        "The time limit in run.json is edited.",
        _edit("run.json", '"limit_s": 8.0', '"limit_s": 9.0'),
        "",
    ),
    (
        "run-file-cut-off",
        "run.json is cut off.",
        lambda out: os.truncate(out / "run.json", 300),
        "run.json",
    ),
)
add_all(FAMILY, _MUST, _expect_refusal, _ALTERED)


def _expect_failed_check(lab: Lab, alter: Callable[[Path], object], words: str) -> str:
    """Alter a finished run with a bag; `barn check` must name what is wrong."""
    _with_bag(lab)
    lab.barn("check", lab.out)
    alter(lab.out)
    complaint = lab.barn("check", lab.out, code=1).err
    hold(words in complaint, complaint)
    return complaint.splitlines()[0].replace(str(lab.folder), "")[:200]


def _with_bag(lab: Lab, bags: str = "all") -> None:
    (lab.folder / "short.yaml").write_text(
        "schema_version: 1\nbase: challenge\nname: short\nlimit_s: 3.0\nfirst_motion_limit_s: 2.0\n"
    )
    words = "run --planner gap --worlds 0 --protocol short.yaml"
    lab.barn(*words.split(), "--bags", bags, "--out", lab.out)


def _bag(out: Path) -> Path:
    return next((out / "bags").glob("*/*.mcap"))


def _flip(out: Path) -> None:
    content = bytearray(_bag(out).read_bytes())
    for place in range(len(content) // 2, len(content) // 2 + 64):
        content[place] ^= 0xFF
    _bag(out).write_bytes(content)


_MUST = "`barn check` names the file and what is wrong; exit code 1."
_DAMAGED = (
    (
        "missing-bag",
        "The file of a bag is removed.",
        lambda out: _bag(out).unlink(),
        "bags/",
    ),
    (
        "bag-cut-off",
        "The bag of a trial is cut in half.",
        lambda out: os.truncate(_bag(out), 30_000),
        "bags/",
    ),
    ("altered-bag", "64 bytes in the middle of a bag are changed.", _flip, "bags/"),
    (
        "empty-bag",
        "The file of a bag is empty.",
        lambda out: os.truncate(_bag(out), 0),
        "bags/",
    ),
    (
        "missing-track",
        "tracks.jsonl is removed.",
        lambda out: (out / "tracks.jsonl").unlink(),
        "has no track",
    ),
    (
        "missing-commands",
        "commands.jsonl is removed.",
        lambda out: (out / "commands.jsonl").unlink(),
        "its commands are missing",
    ),
    (
        "missing-table",
        "results.parquet is removed.",
        lambda out: (out / "results.parquet").unlink(),
        "is missing",
    ),
    (
        "table-cut-off",
        "results.parquet is cut off.",
        lambda out: os.truncate(out / "results.parquet", 500),
        "parquet",
    ),
)
add_all(FAMILY, _MUST, _expect_failed_check, _DAMAGED)


def _differs(lab: Lab, options: Sequence[object], words: str) -> str:
    _copy_unfinished(lab)
    refusal = lab.expect_refusal(*campaign(lab, *options))
    hold(words in refusal, refusal)
    return refusal


_MUST = "Refused in one line that names what differs."
_OTHERS = (
    (
        "other-seed",
        "A campaign is resumed with another seed.",
        ("--seed", 6),
        "seed is 5 there, 6 here",
    ),
    (
        "other-parameters",
        "A campaign is resumed with another planner parameter.",
        ("--set", "gap.max_speed_mps=0.3"),
        "max_speed_mps",
    ),
    (
        "other-simulator",
        "A campaign is resumed with another simulator.",
        ("--sim", "lidar.beams=360"),
        "lidar.beams is 720 there",
    ),
)
add_all(FAMILY, _MUST, _differs, _OTHERS)


@case(FAMILY)
def folder_of_something_else(lab: Lab) -> str:
    """A campaign is told to write to a folder with somebody's thesis.

    Refused in one line; nothing in the folder is touched.
    """
    lab.out.mkdir()
    (lab.out / "thesis.tex").write_text("chapter")
    refusal = lab.expect_refusal(*campaign(lab))
    hold([path.name for path in lab.out.iterdir()] == ["thesis.tex"], "files were made")
    return refusal


@case(FAMILY)
def rerun_of_a_row(lab: Lab) -> str:
    """A row's score is edited and given the right checksum, as somebody does who wants
    to win.

    `barn check` with `--rerun` runs the trial again and names what differs.
    """
    _with_bag(lab, "none")
    path = lab.out / "results.jsonl"
    row = json.loads(unseal_line(path.read_text().rstrip("\n"), ""))
    row["scores"]["challenge"] += 0.1
    line = json.dumps(row, separators=(",", ":"))
    path.write_text(seal_line(line) + "\n")
    write_tables(lab.out, RowFile(lab.out).read())
    complaint = lab.barn("check", lab.out, "--rerun", 1, code=1).err
    hold("scores.challenge" in complaint, complaint)
    return complaint
