"""Many environments at once: `make_vec("barn/Jackal-v0", num_envs=64, vectorization_mode="vector_entry_point")`."""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.environment import JackalEnv, info_of_end
from barn_eval.learning.episode import step_reward
from barn_eval.learning.episodes import Episodes
from barn_planners.policy_space import ACTIONS
from barn_sim.batch import Batch
from barn_sim.nearness import Bools
from barn_worlds.arrays import Floats, Integers
from barn_worlds.config import replace_dotted
from barn_worlds.dataset import open_dataset
from barn_worlds.errors import ConfigError
from barn_worlds.types import NANOSECONDS, Pose2D, Velocity2D

Step = tuple[npt.NDArray[Any], npt.NDArray[np.float64], Bools, Bools, dict[str, Any]]


class JackalVectorEnv(SyncVectorEnv):
    """Environments whose robots advance together: a step is a few compiled calls for all of them.

    Only robots near an obstacle, episodes that may have ended, and whatever needs Python (the shield, a pose in a map)
    are looked at one by one. Every observation, reward and info is that of Gymnasium's SyncVectorEnv, to the last bit.
    threads: among which the robots are divided. config, changes: as of `JackalEnv`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | None = None,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        **changes: Any,
    ) -> None:
        if threads < 1:
            raise ConfigError(f"threads must be at least 1, got {threads}")
        self._config = replace_dotted(config or EnvConfig(), changes, "environment")
        make = partial(JackalEnv, self._config, opened=open_dataset(self._config.dataset))
        super().__init__([make] * num_envs, autoreset_mode=autoreset_mode)
        self._jackals = [_jackal(env) for env in self.envs]
        self._batch = Batch(num_envs, self._jackals[0].simulator_config, threads)
        self._period_s = self._jackals[0].simulator_config.control_period_s
        self._episodes = Episodes(num_envs, self._batch.readings, self._period_s)
        self._wants_map = self._jackals[0].protocol.map_given
        for index, env in enumerate(self._jackals):
            env.join(self._batch, index, self._jackals[0])

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin episodes, in all environments or in those of `options["reset_mask"]`."""
        begun = (options or {}).get("reset_mask", np.ones(self.num_envs, np.bool_))
        self._env_obs = list(self._observations.copy())
        seen, infos = super().reset(seed=seed, options=options)
        for index in np.flatnonzero(begun).tolist():
            self._episodes.put(index, self._jackals[index])
        return seen, infos

    def step(self, actions: npt.NDArray[np.floating]) -> Step:
        """Drive all robots for one control period."""
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs, ACTIONS):
            raise ConfigError(f"actions must be an array of shape {(self.num_envs, ACTIONS)}, got {actions.shape}")
        anew = self.autoreset_mode is AutoresetMode.NEXT_STEP
        resting = self._autoreset_envs if anew else np.zeros(self.num_envs, np.bool_)
        running = np.flatnonzero(~resting)
        rewards, infos = self._drive(running, actions)
        for index in np.flatnonzero(resting).tolist():
            infos = self._add_info(infos, self._begin(index), index)
        self._rewards = rewards
        self._autoreset_envs = self._terminations | self._truncations
        return self._observations.copy(), rewards.copy(), self._terminations.copy(), self._truncations.copy(), infos

    def _drive(self, running: Integers, actions: npt.NDArray[np.floating]) -> tuple[Floats, dict[str, Any]]:
        """Let the episodes that run take a step; return rewards (n,), zero for the others, and infos."""
        episodes, seen = self._episodes, self._observations
        if not episodes.running[running].all():
            raise gymnasium.error.ResetNeeded("reset() must be called before the first step of an episode")
        wanted = self._config.action.commands(actions)
        given, shielded = self._shielded(running, wanted)
        finite = np.asarray(np.isfinite(given).all(axis=1))
        moving = running[finite[running]]
        self._batch.step(moving, given)
        self._encode(moving, seen)
        view = self._config.observation
        nearest_m = seen[:, : view.beams].min(axis=1).astype(np.float64) * view.range_limit_m
        progress_m = episodes.progress(moving)
        rewards = step_reward(self._config.reward, progress_m, self._period_s, nearest_m, shielded)
        there = np.zeros(self.num_envs, np.bool_)
        there[running] = True
        rewards[~there] = 0.0
        self._terminations[:] = self._truncations[:] = False
        infos = self._infos(there)
        for index in running[~finite[running]].tolist():
            episodes.refuse(index, Velocity2D(*given[index].tolist()))
            infos = self._end(index, rewards, infos)
        for index in episodes.judge(moving):
            infos = self._end(index, rewards, infos)
        return rewards, infos

    def _shielded(self, running: Integers, wanted: Floats) -> tuple[Floats, Bools]:
        """Return the commands given (n, 2), and which of them are not those wanted."""
        given, readings = wanted.copy(), self._batch.readings
        if self._config.safety.enabled:
            for index in running:
                env = self._jackals[index]
                moving, scan = Velocity2D(*readings.velocities[index]), env.episode.scan(readings.ranges[index])
                safe = env.shielded(Velocity2D(*wanted[index].tolist()), moving, scan)
                given[index] = safe.linear, safe.angular
        changed: Bools = ((given != wanted) & ~np.isnan(wanted)).any(axis=1)
        return given, changed

    def _encode(self, moving: Integers, seen: npt.NDArray[np.float32]) -> None:
        """Fill in the observations after a step."""
        readings, poses = self._batch.readings, self._batch.readings.odometry
        if self._wants_map:
            poses = poses.copy()
            for index in moving:
                pose = self._jackals[index].episode.localised(Pose2D(*poses[index].tolist()))
                poses[index] = pose.x, pose.y, pose.yaw
        self._jackals[0].encoder.encode_all(
            self._jackals[0].episode.sensors.scan, readings.ranges, poses, self._episodes.goals, readings.velocities,
            moving, seen,
        )  # fmt: skip

    def _infos(self, there: Bools) -> dict[str, Any]:
        """Return what `info` has of every step, for those who took it."""
        if not there.any():
            return {}
        times_s = self._batch.readings.stamps_ns / NANOSECONDS
        columns = {"world": self._episodes.worlds, "time_s": times_s, "way_left_m": self._episodes.left_m}
        infos: dict[str, Any] = {}
        for name, values in columns.items():
            infos[name], infos[f"_{name}"] = np.where(there, values, 0), there.copy()
        return infos

    def _end(self, index: int, rewards: Floats, infos: dict[str, Any]) -> dict[str, Any]:
        """End an episode that has a verdict, and begin a new one if that is to be in the same step."""
        env = self._jackals[index]
        verdict = env.episode.verdict
        assert verdict is not None
        self._episodes.running[index] = False
        ended = env.conclude(float(rewards[index]), verdict)
        rewards[index], self._terminations[index], self._truncations[index] = ended
        info = info_of_end(env.episode)
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            return self._add_info(infos, info, index)
        info |= {name: infos[name][index] for name in ("world", "time_s", "way_left_m")}
        last = {"final_obs": self._observations[index].copy(), "final_info": info}
        return self._add_info(self._add_info(infos, last, index), self._begin(index), index)

    def _begin(self, index: int) -> dict[str, Any]:
        """Begin a new episode and return its info."""
        self._observations[index], info = self._jackals[index].reset()
        self._episodes.put(index, self._jackals[index])
        return info

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environments and end the threads."""
        super().close_extras(**kwargs)
        self._batch.close()


def _jackal(env: gymnasium.Env[Any, Any]) -> JackalEnv:
    unwrapped = env.unwrapped
    assert isinstance(unwrapped, JackalEnv)
    return unwrapped
