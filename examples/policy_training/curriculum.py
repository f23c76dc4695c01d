"""A curriculum: worlds from easy to difficult, more of them with success."""

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
    """An environment whose worlds become harder with success.

    Its worlds are ordered by number, which in the shipped data sets is the order of
    their difficulty. They are drawn from the easiest (level 0) up to `level`.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], config: CurriculumConfig | None = None
    ) -> None:
        """Wrap an environment.

        Args:
            env: `barn/Jackal-v0` with all worlds of the curriculum.
            config: Levels and success rate.
        """
        super().__init__(env)
        self.config = config or CurriculumConfig()
        self.level = self.config.first_level
        self._jackal: Any = env.unwrapped
        self._worlds = self._jackal.worlds
        self._successes: deque[bool] = deque(maxlen=self.config.window)
        self._select_worlds()

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step and record the success at the end of an episode."""
        observation, reward, terminated, truncated, info = super().step(action)
        if terminated or truncated:
            self.record(info["is_success"])
        return observation, reward, terminated, truncated, info

    def record(self, success: bool) -> bool:
        """Record the end of an episode; return whether that raises the level."""
        self._successes.append(success)
        if len(self._successes) < self.config.window or self.level >= 1.0:
            return False
        needed = self.config.promotion_rate * self.config.window
        if sum(self._successes) < needed:
            return False
        self.widen()
        return True

    def widen(self) -> None:
        """Raise the level by a step and count successes from zero again."""
        self.level = min(1.0, self.level + self.config.step)
        self._successes.clear()
        self._select_worlds()

    def _select_worlds(self) -> None:
        # The easiest world has level 0, also if it is the only one.
        levels = np.linspace(0.0, 1.0, len(self._worlds))
        count = bisect_right(levels.tolist(), self.level + 1e-12)
        self._jackal.worlds = self._worlds[:count]
