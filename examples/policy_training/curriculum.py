"""Worlds from easy to difficult: those drawn at present, which become more with success."""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from barn_worlds.base.config import Checked, quantity


@dataclass(frozen=True)
class CurriculumConfig(Checked):
    """How many worlds are drawn from at first, and when that becomes more."""

    first_level: float = quantity(
        0.1, "level of the hardest worlds drawn at first", "", 0.0, 1.0
    )
    step: float = quantity(0.05, "what this level rises by", "", 0.001, 1.0)
    promotion_rate: float = quantity(
        0.8, "success rate from which it rises", "", 0.0, 1.0
    )
    window: int = quantity(
        20, "episodes that this rate is taken over", "", 1, 1_000_000
    )


class Curriculum(gymnasium.Wrapper):  # type: ignore[type-arg, misc, unused-ignore]
    """An environment whose worlds are drawn from easy (level 0) up to a `level` that rises with success.

    env: `barn/Jackal-v0`, whose worlds are taken in the order of their numbers, which is that of their difficulty in
    the shipped data sets.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], config: CurriculumConfig | None = None
    ) -> None:
        super().__init__(env)
        self.config = config or CurriculumConfig()
        self._jackal: Any = env.unwrapped
        self._all = self._jackal.worlds
        self._recent: deque[bool] = deque(maxlen=self.config.window)
        self.level = self.config.first_level
        self._choose()

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take the step, and take note of an episode's end."""
        seen, reward, terminated, truncated, info = super().step(action)
        if terminated or truncated:
            self.record(info["is_success"])
        return seen, reward, terminated, truncated, info

    def record(self, success: bool) -> bool:
        """Take note of an episode's end; raise the level and count anew once enough are successes; tell whether."""
        self._recent.append(success)
        full = len(self._recent) == self.config.window
        if (
            not full
            or self.level >= 1.0
            or sum(self._recent) < self.config.promotion_rate * self.config.window
        ):
            return False
        self.widen()
        return True

    def widen(self) -> None:
        """Raise the level by the configured step, and forget the episodes before."""
        self.level = min(1.0, self.level + self.config.step)
        self._recent.clear()
        self._choose()

    def _choose(self) -> None:
        levels = np.linspace(0.0, 1.0, len(self._all)) if len(self._all) > 1 else [0.0]
        self._jackal.worlds = self._all[: bisect_right(levels, self.level + 1e-12)]
