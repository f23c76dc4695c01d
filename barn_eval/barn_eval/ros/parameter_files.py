"""The parameter files of the package: `python -m barn_eval.ros.parameter_files config` writes them anew."""

from __future__ import annotations

import sys

from barn_eval.ros.evaluator_config import EvaluatorConfig
from barn_worlds.ros.parameter_files import parameter_file, write


def files() -> dict[str, str]:
    """Return the files by name; what only a supervisor sets is left out."""
    supervised = ("supervisor_fd",)
    config = EvaluatorConfig()
    text = parameter_file("/**/evaluator", "The evaluator with its defaults.", [config], leave_out=supervised)
    return {"evaluator.yaml": text}


if __name__ == "__main__":
    sys.exit(write(files(), sys.argv[1:]))
