"""Fail if a result of `barn bench --against` has a figure that became 10% worse."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

LOSS = 0.1


def losses(result: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Return a line for each figure that has lost more than `LOSS`.

    Args:
        result: What `barn bench --json` has printed.
    """
    return [
        f"slower: {change['name']}, {change['ratio']:.2f} times as good as before"
        for change in result["changes"]
        if change["ratio"] < 1.0 - LOSS
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", type=Path, help="what barn bench --json has printed")
    result = json.loads(parser.parse_args().result.read_text("utf-8"))
    sys.exit("\n".join(losses(result)) or None)
