"""The planner `rogue` of mode direct.

Drives ahead and goes wrong, once, in the way that its parameter `kind` names.
"""

import ctypes
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, nan
from typing import Any

import numpy as np

from barn_eval.running.direct import reference_loop
from barn_planners.interface import Decision, Observation, Planner, Task
from barn_planners.registry import PlannerEntry
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import Velocity2D

_GOOD_CYCLES = 20


@dataclass(frozen=True)
class RogueConfig(Checked):
    """The parameters."""

    kind: str = quantity("none", "what goes wrong")


def _raise(error: BaseException) -> Any:
    raise error


def _loop() -> None:
    while True:
        pass


def _catch() -> None:
    while True:
        try:
            time.sleep(600.0)
        except BaseException:
            continue


def _meddle_with_random_state() -> None:
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    np.random.set_state(np.random.RandomState(2).get_state())  # noqa: NPY002


def _ignore() -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(600.0)


def _eat() -> None:
    eaten = []
    while True:
        eaten.append(bytearray(50_000_000))


def _recurse(depth: int = 0) -> int:
    return _recurse(depth + 1) + 1


def _work() -> None:
    """Compute for 30 ms on the reference computer, and sleep for as long on any."""
    for _ in range(5):
        reference_loop()
    time.sleep(0.03)


_DEEDS: dict[str, Callable[[], Any]] = {
    "none": lambda: None,
    "works": lambda: None,
    "raises": lambda: _raise(RuntimeError("out of\nideas")),
    "no-decision": lambda: "forward",
    "wrong-type": lambda: Decision((0.5, 0.0)),  # type: ignore[arg-type]
    "nan": lambda: Decision(Velocity2D(nan, 0.0)),
    "inf": lambda: Decision(Velocity2D(0.5, inf)),
    "huge": lambda: Decision(Velocity2D(1e300, -1e300)),
    "system-exit": lambda: sys.exit("I am done"),
    "keyboard-interrupt": lambda: _raise(KeyboardInterrupt()),
    "os-exit": lambda: os._exit(7),
    "segfault": lambda: ctypes.string_at(0),
    "kills-itself": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "endless-loop": _loop,
    "hangs-in-c": lambda: ctypes.PyDLL(None).sleep(600),  # holds the interpreter's lock
    "catches-everything": _catch,
    "random-state": _meddle_with_random_state,
    "memory": _eat,
    "recursion": _recurse,
    "ignores-signals": _ignore,
    "working-directory": lambda: os.chdir("/"),
    "closes-files": lambda: os.closerange(3, 256),
}


@dataclass
class Rogue(Planner):
    """Drives ahead for 20 cycles, then does its deed once."""

    config: RogueConfig
    cycles: int = field(default=0)

    def start(self, task: Task, seed: int) -> None:  # noqa: ARG002
        """Begin."""
        self.cycles = 0
        if self.config.kind == "raises-at-start":
            raise OSError("no such map")

    def step(self, observation: Observation) -> Decision:  # noqa: ARG002
        """Drive ahead, or do it."""
        self.cycles += 1
        if self.config.kind == "works":
            _work()
        done = _DEEDS[self.config.kind]() if self.cycles == _GOOD_CYCLES else None
        return (
            Decision(Velocity2D(0.5, 0.0))
            if done is None or isinstance(done, tuple)
            else done
        )


ENTRY = PlannerEntry(Rogue, {"default": RogueConfig()})
