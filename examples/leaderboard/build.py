"""Verify submissions and build the page of the board: `python3 build.py [SUBMISSIONS [OUT]]`.

Each file of SUBMISSIONS (submissions) is verified with `barn verify` and must be of the task, worlds and seed of
board.json beside this script. OUT (site) gets index.html with those that hold. Prints a line for each and exits with 1
if any does not hold.
"""

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
BARN = [sys.executable, "-m", "barn_eval"]


def verified(file: Path, folder: Path) -> str:
    """Unpack a submission that holds into a folder; return what is wrong with one that does not."""
    told = subprocess.run(  # noqa: S603 (a file of the board, and no shell)
        [*BARN, "verify", file, "--out", folder, "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    if not told.stdout:
        return told.stderr.strip() or "barn verify did not start"
    found = json.loads(told.stdout)
    if not found["holds"]:
        return "; ".join(found["problems"][:3])
    rules = json.loads((HERE / "board.json").read_text("utf-8"))
    return next(
        (
            f"{key} is {found[key]}, must be {rule}"
            for key, rule in rules.items()
            if found[key] != rule
        ),
        "",
    )


def main() -> int:
    """Verify all submissions and write the page."""
    submissions = Path(sys.argv[1] if len(sys.argv) > 1 else HERE / "submissions")
    site = Path(sys.argv[2] if len(sys.argv) > 2 else HERE / "site")
    good, bad = [], 0
    with TemporaryDirectory() as kept:
        for file in sorted(submissions.glob("*.barn.zip")):
            folder = Path(kept) / file.name.removesuffix(".barn.zip")
            problem = verified(file, folder)
            print(f"{file.name}: {problem or 'holds'}")
            good += [] if problem else [folder]
            bad += bool(problem)
        if good:
            site.mkdir(parents=True, exist_ok=True)
            subprocess.run(  # noqa: S603
                [*BARN, "leaderboard", *good, "--out", site / "index.html"], check=True
            )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
