"""Verify submissions and build the page of the board.

    python3 build.py [SUBMISSIONS [OUT]]

`barn verify` checks each file of SUBMISSIONS (submissions). Its task, worlds and seed
must be those of board.json beside this script. OUT (site) gets index.html with the
submissions that hold. The script prints a line for each and exits with 1 if any does
not hold.
"""

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
BARN = [sys.executable, "-m", "barn_eval"]
SUFFIX = ".barn.zip"
MAX_PROBLEMS = 3


def verify(submission: Path, folder: Path) -> str:
    """Return what is wrong with a submission, or an empty text.

    Args:
        submission: File of `barn submit`.
        folder: Folder to unpack the results into if they hold.
    """
    process = subprocess.run(  # noqa: S603 (a file of the board, and no shell)
        [*BARN, "verify", submission, "--out", folder, "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    if not process.stdout:
        return process.stderr.strip() or "barn verify did not start"
    report = json.loads(process.stdout)
    if not report["holds"]:
        return "; ".join(report["problems"][:MAX_PROBLEMS])

    board = json.loads((HERE / "board.json").read_text("utf-8"))
    for key, value in board.items():
        if report[key] != value:
            return f"{key} is {report[key]}, must be {value}"
    return ""


def main() -> int:
    """Verify all submissions, write the page and return the exit code."""
    submissions = Path(sys.argv[1] if len(sys.argv) > 1 else HERE / "submissions")
    site = Path(sys.argv[2] if len(sys.argv) > 2 else HERE / "site")
    folders = []
    exit_code = 0
    with TemporaryDirectory() as temporary:
        for submission in sorted(submissions.glob(f"*{SUFFIX}")):
            folder = Path(temporary) / submission.name.removesuffix(SUFFIX)
            problem = verify(submission, folder)
            print(f"{submission.name}: {problem or 'holds'}")
            if problem:
                exit_code = 1
            else:
                folders.append(folder)

        site.mkdir(parents=True, exist_ok=True)
        page = site / "index.html"
        # A new board has no submission, and its page is published all the same.
        page.write_text("<!doctype html><title>Board</title>No submission holds yet.\n")
        if folders:
            subprocess.run(  # noqa: S603
                [*BARN, "leaderboard", *folders, "--out", page], check=True
            )
    return exit_code


if __name__ == "__main__":
    sys.exit(main())
