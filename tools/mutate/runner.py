"""Run the unit tests of a module with its changed text in place of its file, in forked processes."""

from __future__ import annotations

import gc
import importlib
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from multiprocessing.connection import wait
from pathlib import Path
from types import CodeType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")

# Slow to import, and without a module that is changed: imported once, before the first fork.
SHARED = ("click.testing", "hypothesis.strategies", "pytest", "scipy.stats", "barn_sim.config", "barn_worlds.dataset")

fork = multiprocessing.get_context("fork")


class Changed(SourceFileLoader):
    """Finder and loader of one module, from changed code in place of its file."""

    def __init__(self, module: str, code: CodeType) -> None:
        super().__init__(module, str(source_of(module)))
        self.code = code

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        """Claim the one module."""
        return spec_from_file_location(name, self.path, loader=self) if name == self.name else None

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
    for name in SHARED:
        importlib.import_module(name)
    gc.freeze()


def survivals(module: str, texts: Sequence[str], tests: Sequence[Path], jobs: int, limit_s: float) -> Iterator[bool]:
    """Yield for each text of a module, in order, whether all tests pass with it; after limit_s they have not."""
    running: dict[int, tuple[Any, float]] = {}
    done: dict[int, bool] = {}
    for number in range(len(texts)):
        while number not in done:
            while len(running) < jobs and (next_one := len(done) + len(running)) < len(texts):
                code = compile(texts[next_one], str(source_of(module)), "exec", dont_inherit=True)
                process = fork.Process(target=_run_tests, args=(module, code, tests))
                process.start()
                running[next_one] = process, time.monotonic() + limit_s
            soonest = min(end for _, end in running.values())
            wait([process.sentinel for process, _ in running.values()], max(0.0, soonest - time.monotonic()))
            for key, (process, end) in list(running.items()):
                if process.is_alive() and time.monotonic() >= end:
                    with suppress(ProcessLookupError):
                        os.killpg(process.pid, signal.SIGKILL)
                    process.join()
                if not process.is_alive():
                    done[key] = process.exitcode == 0
                    del running[key]
        yield done[number]


def _run_tests(module: str, code: CodeType, tests: Sequence[Path]) -> None:
    """Run the tests in this process, the same ones each time; exit 0 if all pass."""
    import pytest  # noqa: PLC0415
    from hypothesis import Phase, settings  # noqa: PLC0415

    os.setsid()
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    settings.register_profile("mutate", derandomize=True, database=None, phases=[Phase.explicit, Phase.generate])
    settings.load_profile("mutate")
    sys.meta_path.insert(0, Changed(module, code))
    sys.exit(pytest.main(["-x", "-q", "--assert=plain", "--tb=no", f"--rootdir={ROOT}", *map(str, tests)]))
