"""The Gymnasium environment `barn/Jackal-v0`: trials of the benchmark, driven by a learner."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.drawing import TopView
from barn_eval.learning.episodes import Episodes, Known, info_of_end, way_points
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.policy.collision_check import CollisionCheckConfig
from barn_planners.policy.space import ACTIONS, Vector
from barn_planners.robots import fit_to_robot, lidar_mount_changes
from barn_sim.config import robot_of
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import seconds
from barn_worlds.datasets.dataset import Dataset, open_dataset, select_worlds
from barn_worlds.robots.files import load_robot

RENDER_MODES = ("rgb_array",)
_MOST_KEPT = 2000  # worlds of which everything is kept
# What ends an episode by what was done; anything else ends it by the time or a fault.
_TERMINAL = (Outcome.SUCCESS, Outcome.COLLISION, Outcome.INVALID_COMMAND)
_OPTIONS = ("world", "campaign_seed", "repetition")


class JackalEnv(gymnasium.Env[Vector, npt.NDArray[np.floating]]):  # type: ignore[misc, unused-ignore]
    """A Jackal that is to reach the goal of a world, observed and commanded as `barn_planners.policy.space` says.

    An episode is a trial of the benchmark: it terminates by a success, a collision (if the protocol looks at them) or a
    command that is not a number; it is truncated by the limits of time. `info` holds the world's number, the time and
    the way left; at the end also the outcome with its detail, whether it is a success, and the scores.

    config: what the environment is; changes: fields of it by dotted name, so that `gymnasium.make` takes them:
    `make("barn/Jackal-v0", worlds="0:100", **{"reward.success": 20.0})`. opened: its data set, if it is open already.

    `reset(options={"world": 7})` chooses the world. With `campaign_seed` (and `repetition`, 0) as well, the episode is
    the very trial that `barn run --seed` makes of these numbers.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012 (Gymnasium's)

    def __init__(
        self,
        config: EnvConfig | None = None,
        render_mode: str | None = None,
        opened: Dataset | None = None,
        **changes: object,
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ConfigError(
                f"render_mode must be None or {RENDER_MODES[0]!r}, got {render_mode!r}"
            )
        self.render_mode = render_mode
        self.config = replace_dotted(config or EnvConfig(), changes, "environment")
        robot = load_robot(self.config.robot)
        self._dataset = (opened or open_dataset(self.config.dataset)).for_robot(robot)
        self.worlds = tuple(
            sorted(select_worlds(self.config.worlds, self._dataset.world_numbers))
        )  # drawn from, evenly
        self.protocol = load_protocol(self.config.protocol)
        self.simulator_config = simulator_config(
            self.protocol, self.config.simulator, robot
        )
        self._dataset.require_fit(robot_of(self.simulator_config), self.worlds)
        self._safety = self._placed(self.config.safety)
        low, high = self.config.observation.bounds()
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)
        self.metadata = {
            **self.metadata,
            "render_fps": max(1, round(1.0 / self.simulator_config.control_period_s)),
        }
        self._picture: TopView | None = None
        self._place: tuple[Episodes, int] | None = None
        self._joined, self._driving = False, np.zeros(1, np.bool_)
        self._unseen = np.zeros(self.config.observation.size, np.float32)

    def episodes(self, count: int = 1) -> Episodes:
        """Return room for so many episodes of this environment."""
        return Episodes(count, self.config, self.simulator_config, self._safety)

    def join(self, episodes: Episodes, index: int) -> None:
        """Let the episodes from now on advance among others, instead of by `step`."""
        self._place, self._joined = (episodes, index), True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vector, dict[str, Any]]:
        """Begin an episode in the world of `options`, or in one drawn; among others, observation and info are empty."""
        super().reset(seed=seed)
        if self._place is None:
            self._place = self.episodes(), 0
        episodes, index = self._place
        episodes.begin(index, *self._drawn(_checked_options(options), episodes.known))
        if self._joined:
            return self._unseen, {}
        episodes.look(np.arange(1))
        episodes.judge(np.arange(1))
        if self.render_mode:
            self._picture = TopView(episodes.trial(0).spec)
            self._picture.add(episodes)
        return episodes.seen[0].copy(), self._info(episodes)

    def step(
        self, action: npt.NDArray[np.floating]
    ) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Drive for one control period; ResetNeeded before `reset` and after the end of an episode."""
        if self._place is None or not self._place[0].running[0]:
            raise gymnasium.error.ResetNeeded(
                "reset() must be called before the first step of an episode"
            )
        action = np.asarray(action)
        if action.shape != (ACTIONS,):
            raise ConfigError(
                f"action must be an array of shape {(ACTIONS,)}, got {action.shape}"
            )
        episodes = self._place[0]
        rewards, ended = episodes.step(self._driving, action[None])
        if self._picture is not None:
            self._picture.add(episodes)
        terminated, truncated = self.conclude() if ended else (False, False)
        return (
            episodes.seen[0].copy(),
            float(rewards[0]),
            terminated,
            truncated,
            self._info(episodes),
        )

    def conclude(self) -> tuple[bool, bool]:
        """Return whether the episode, which has ended, terminated or was truncated."""
        assert self._place is not None
        episodes, index = self._place
        verdict = episodes.trial(index).verdict
        terminated = verdict is not None and verdict.outcome in _TERMINAL
        return terminated, not terminated

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) from above; None without a render mode."""
        if self._place is None or self._picture is None:
            return None
        return self._picture.draw(self._place[0])

    def close(self) -> None:
        """Release the physics engine."""
        if self._place is not None and not self._joined:
            self._place[0].close()
        self._place = self._picture = None

    def _drawn(
        self, options: Mapping[str, int], known: Known
    ) -> tuple[TrialSpec, Floats]:
        """Return a new trial and the way in its world; what `options` do not give is drawn."""
        index = options.get("world")
        if index is None:
            index = self.worlds[int(self.np_random.random() * len(self.worlds))]
        seed = options.get("campaign_seed")
        seed = int(self.np_random.integers(2**62)) if seed is None else seed
        repetition = options.get("repetition", 0)
        if index in known:
            spec, way = known[index]
            return spec.with_seed(seed, repetition), way
        if len(known) >= _MOST_KEPT:
            known.clear()
        world = self._dataset.load(index)
        spec = TrialSpec(
            dataset=self._dataset.name,
            world_number=index,
            world=world,
            planner="policy",
            preset="",
            overrides={},
            protocol=self.protocol,
            simulator=self.simulator_config,
            run_seed=seed,
            repetition=repetition,
            declared_mps=self.config.action.cap_mps,
        )
        known[index] = (
            spec,
            way_points(world, spec.course, self.config.reward.progress_along),
        )
        return known[index]

    def _placed(self, safety: CollisionCheckConfig) -> CollisionCheckConfig:
        """Return the shield for the robot, its lidar where the simulator has it; ConfigError for another place."""
        mount_m = self.simulator_config.lidar.mount_x_m
        if safety.lidar_x_m not in (CollisionCheckConfig().lidar_x_m, mount_m):
            mounted = f"mounted at {mount_m:g} m (simulator parameter lidar.mount_x_m)"
            raise ConfigError(
                f"safety.lidar_x_m is {safety.lidar_x_m:g}, but the lidar is {mounted}"
            )
        placed = replace(safety, lidar_x_m=mount_m)
        robot = robot_of(self.simulator_config)
        return replace_dotted(
            placed,
            fit_to_robot(placed, robot) | lidar_mount_changes(placed, robot.lidar),
            "safety",
        )

    def _info(self, episodes: Episodes) -> dict[str, Any]:
        info = {
            "world": int(episodes.worlds[0]),
            "time_s": seconds(int(episodes.readings.stamps_ns[0])),
            "way_left_m": float(episodes.left_m[0]),
        }
        return info | info_of_end(episodes.trial(0))


def _checked_options(options: Mapping[str, Any] | None) -> dict[str, int]:
    """Return the options of a reset, all of them numbers."""
    checked = {}
    for name, value in (options or {}).items():
        if name not in _OPTIONS:
            raise ConfigError(
                f"reset: unknown option {name!r}{suggest(name, _OPTIONS)}"
            )
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if not whole or value < 0:
            raise ConfigError(
                f"reset: option {name!r} must be a whole number from 0, got {value!r}"
            )
        checked[name] = int(value)
    return checked
