"""Run the unit tests of a module with changed text in place of its file.

Each run is a forked process.
"""

import gc
import importlib
import multiprocessing
import os
import resource
import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from multiprocessing.connection import wait
from pathlib import Path
from types import CodeType
from typing import Any

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")

# Slow to import, and without a module that is changed: imported once, before the first
# fork.
SHARED = (
    "click.testing",
    "hypothesis.strategies",
    "pytest",
    "scipy.stats",
    "barn_sim.config",
    "barn_worlds.datasets.dataset",
)

fork = multiprocessing.get_context("fork")


class Changed(SourceFileLoader):
    """Finder and loader of one module, from changed code in place of its file."""

    def __init__(self, module: str, code: CodeType) -> None:
        super().__init__(module, str(source_of(module)))
        self.code = code

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        """Claim the one module."""
        return (
            spec_from_file_location(name, self.path, loader=self)
            if name == self.name
            else None
        )

    def get_code(self, _name: str) -> CodeType:
        """Return the changed code."""
        return self.code


def source_of(module: str) -> Path:
    """Return the file of a dotted module."""
    return ROOT / module.partition(".")[0] / Path(*module.split(".")).with_suffix(".py")


def prepare() -> None:
    """Import what all tests share, from this repository."""
    sys.path[:0] = [str(ROOT / package) for package in PACKAGES]
    sys.dont_write_bytecode = True
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    os.environ["NUMBA_DISABLE_JIT"] = (
        "1"  # kernels are kept on disk by their file, which no mutant changes
    )
    os.environ.pop(
        "PYTEST_ADDOPTS", None
    )  # options of plugins, and of a run that this one may be part of
    for name in SHARED:
        importlib.import_module(name)
    gc.freeze()


def seconds_needed(module: str, tests: Sequence[Path]) -> int | None:
    """Return the processor time that the tests of a module take as it is, rounded up.

    None if they fail.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    source = source_of(module).read_text("utf-8")
    if not all(survivals(module, [source], tests, 1, 600)):
        return None
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return 1 + int(used_s)


def survivals(
    module: str, texts: Sequence[str], tests: Sequence[Path], jobs: int, limit_s: int
) -> Iterator[bool]:
    """Yield for each text of a module, in order, whether all tests pass with it.

    limit_s: processor time after which a run is ended and has not passed. Unlike a
    limit on the time of day it is the same on a busy machine; nothing that is tested
    here waits.
    """
    running: dict[int, Any] = {}
    done: dict[int, bool] = {}
    for number in range(len(texts)):
        while number not in done:
            while len(running) < jobs and (next_one := len(done) + len(running)) < len(
                texts
            ):
                code = compile(
                    texts[next_one], str(source_of(module)), "exec", dont_inherit=True
                )
                running[next_one] = fork.Process(
                    target=_run_tests, args=(module, code, tests, limit_s)
                )
                running[next_one].start()
            wait([process.sentinel for process in running.values()])
            for key, process in list(running.items()):
                if not process.is_alive():
                    done[key] = process.exitcode == 0
                    del running[key]
        yield done[number]


def _run_tests(
    module: str, code: CodeType, tests: Sequence[Path], limit_s: int
) -> None:
    """Run the tests in this process, the same ones each time; exit 0 if all pass."""
    import pytest  # noqa: PLC0415
    from hypothesis import Phase, settings  # noqa: PLC0415

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    settings.register_profile(
        "mutate",
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],
    )
    settings.load_profile("mutate")
    sys.meta_path.insert(0, Changed(module, code))
    options = ["-x", "-q", "--assert=plain", "--tb=no", f"--rootdir={ROOT}"]
    sys.exit(pytest.main([*options, *map(str, tests)]))
