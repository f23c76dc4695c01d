"""Count the tests in the result files under a build folder.

Exit 1 if any failed or a folder has none.
"""

import sys
from pathlib import Path

from defusedxml import ElementTree


def count(file: Path) -> tuple[int, int, int]:
    """Return (passed, failed, skipped) of one JUnit file."""
    passed = failed = skipped = 0
    for case in ElementTree.parse(file).iter("testcase"):
        kinds = {child.tag for child in case}
        if kinds & {"failure", "error"}:
            failed += 1
        elif "skipped" in kinds:
            skipped += 1
        else:
            passed += 1
    return passed, failed, skipped


def main(build: Path, folders: list[str]) -> int:
    """Print the totals over the folders as the last line."""
    totals = [0, 0, 0]
    for folder in folders:
        files = list((build / folder).glob("**/pytest.xml"))
        if not files:
            print(f"{folder}: no test results in {build / folder}")
            totals[1] += 1
        for file in files:
            totals = [a + b for a, b in zip(totals, count(file), strict=True)]
    print(f"{totals[0]} passed, {totals[1]} failed, {totals[2]} skipped")
    return 1 if totals[1] or not totals[0] else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
