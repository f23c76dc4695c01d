"""Mutation check of the code that decides results.

A unit test should fail for every small change to it.

    python qa/checks/mutate                                # all modules
    python qa/checks/mutate trials.referee --sample 20     # some mutants of one module
    python qa/checks/mutate --page docs/mutation.md        # all modules; write the page

Each mutant changes one expression or statement (changes.py). It is never written to a
file: a forked process imports the changed text in place of the module and runs the
module's unit tests until one fails. Tests that hang count as failed. Mutants that no
test can kill are listed with the reason in survivors.yaml; exit 1 for any other
survivor.
"""

import argparse
import json
import os
import random
import sys
from collections.abc import Sequence
from pathlib import Path

from changes import Mutant, mutants_of
from report import BEGIN, Tried, load_reasons, records, summary, survivors, write_page
from runner import ROOT, prepare, seconds_needed, source_of, survivals

# Modules, and the test file of their package that is to kill their mutants.
TESTS = {
    "barn_eval.trials.rules": "trials/test_referee",
    "barn_eval.trials.referee": "trials/test_referee",
    "barn_eval.trials.protocol": "trials/test_protocol",
    "barn_eval.trials.result": "trials/test_result",
    "barn_eval.trials.seeds": "trials/test_result",
    "barn_eval.trials.trajectory": "trials/test_trajectory",
    "barn_eval.trials.encounters": "trials/test_encounters",
    "barn_eval.ros.adapter": "ros/test_adapter",
    "barn_eval.ros.sequencer": "ros/test_sequencer",
    "barn_eval.analysis.statistics": "analysis/test_statistics",
    "barn_eval.analysis.compare": "analysis/test_compare",
    "barn_eval.analysis.measures": "analysis/test_measures",
    "barn_metrics.bootstrap": "test_bootstrap",
}


def tests_of(module: str) -> list[Path]:
    """Return the test files of a dotted module."""
    package = module.partition(".")[0]
    return [ROOT / package / "test" / f"{TESTS[module]}.py"]


def select_mutants(
    modules: Sequence[str], sample: int | None, seed: int
) -> dict[str, list[Mutant]]:
    """Return the mutants to try, by module: all, or so many drawn from all of them.

    Raises:
        SystemExit: For an unknown name.
    """
    for module in modules:
        ending = f".{module}"
        if not any(f".{name}".endswith(ending) for name in TESTS):
            sys.exit(f"no module {module!r}, choose from {', '.join(TESTS)}")
    endings = tuple(f".{module}" for module in modules)
    names = [name for name in TESTS if not modules or f".{name}".endswith(endings)]
    every = [
        (name, mutant)
        for name in names
        for mutant in mutants_of(source_of(name).read_text("utf-8"))
    ]
    if sample is not None and sample < len(every):
        indices = random.Random(seed).sample(range(len(every)), sample)
        every = [every[index] for index in sorted(indices)]
    selection: dict[str, list[Mutant]] = {}
    for name, mutant in every:
        selection.setdefault(name, []).append(mutant)
    return selection


def check(
    module: str, mutants: Sequence[Mutant], tests: Sequence[Path], jobs: int
) -> list[Tried]:
    """Return what became of each mutant of a module.

    Raises:
        SystemExit: If the tests fail without any.
    """
    needed_s = seconds_needed(module, tests)
    if needed_s is None:
        files = ", ".join(map(str, tests))
        sys.exit(f"{module}: its tests fail without a change: {files}")
    texts = [mutant.text for mutant in mutants]
    survived = survivals(module, texts, tests, jobs, 10 * needed_s)
    return [
        Tried(module, mutant, not alive)
        for mutant, alive in zip(mutants, survived, strict=True)
    ]


def main() -> int:
    """Try the mutants asked for.

    Return 1 unless exactly those survive that survivors.yaml lists.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "modules",
        nargs="*",
        help="end of a module's name, such as trials.referee; default: all",
    )
    parser.add_argument(
        "--sample", type=int, metavar="N", help="try N mutants, drawn from all"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="seed of --sample (default 0)"
    )
    parser.add_argument(
        "--tests",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="run these tests, not the module's own",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count(),
        metavar="N",
        help="processes at a time",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--page", type=Path, help="write the results into this page")
    options = parser.parse_args()
    if options.page and not (
        options.page.is_file() and BEGIN in options.page.read_text("utf-8")
    ):
        parser.error(f"--page {options.page}: must be a file with the line {BEGIN}")
    prepare()
    outcomes = []
    for module, mutants in select_mutants(
        options.modules, options.sample, options.seed
    ).items():
        module_outcomes = check(
            module, mutants, options.tests or tests_of(module), options.jobs
        )
        print(f"{module}: {summary(module_outcomes)}", file=sys.stderr)
        outcomes += module_outcomes
    survivor_changes = {outcome.change for outcome in outcomes if not outcome.killed}
    reasons = load_reasons()
    tried_changes = {outcome.change for outcome in outcomes}
    killed_changes = reasons.keys() & tried_changes - survivor_changes
    if options.page:
        write_page(options.page, outcomes)
    if options.json:
        print(
            json.dumps(
                {"summary": summary(outcomes), "survivors": records(outcomes)}, indent=1
            )
        )
    else:
        print(
            survivors(outcomes),
            *(
                f"killed, but listed as a survivor: {change}\n"
                for change in killed_changes
            ),
            summary(outcomes),
            sep="",
        )
    return int(bool(killed_changes or survivor_changes - reasons.keys()))


if __name__ == "__main__":
    sys.exit(main())
