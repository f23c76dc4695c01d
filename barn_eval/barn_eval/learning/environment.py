"""The Gymnasium environment `barn/Jackal-v0`: trials of the benchmark, driven by a learner."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.curriculum import Curriculum
from barn_eval.learning.drawing import CameraView, TopView
from barn_eval.learning.episode import TERMINAL, Episode, WayLeft, reward_of_end, step_reward
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.policy.planner import SafetyConfig, safe_command
from barn_planners.policy.space import ACTIONS, ObservationEncoder, Vector
from barn_planners.robots import fitted, lidar_place
from barn_sim.body.bullet import PhysicsClient
from barn_sim.config import SimulatorConfig, robot_of
from barn_sim.drawing.camera import CAMERAS
from barn_sim.motion.batch import Batch
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import Scan, Velocity2D, seconds
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.dataset import Dataset, open_dataset, select_worlds
from barn_worlds.worlds.world import World

RENDER_MODES = ("rgb_array",)
_MOST_KEPT = 2000  # worlds of which everything is kept
_OPTIONS = ("world", "campaign_seed", "repetition")


class JackalEnv(gymnasium.Env[Vector, npt.NDArray[np.floating]]):  # type: ignore[misc, unused-ignore]
    """A Jackal that is to reach the goal of a world, observed and commanded as `barn_planners.policy.space` says.

    An episode is a trial in the simulator and under the referee of the benchmark: it terminates by a success, a
    collision (if the protocol looks at them) or a command that is not a number; it is truncated by the protocol's
    limits of time. `info` holds the world's number, the time and the way left; at the end also the outcome with its
    detail, whether it is a success, and the scores.

    config: what the environment is; changes: fields of it by dotted name, so that `gymnasium.make` takes them:
    `make("barn/Jackal-v0", worlds="0:100", **{"reward.success": 20.0})`. Raises BarnError for what is not allowed.

    opened: the data set of the configuration, if it is open already.

    render_camera: "chase", "top" or "side" draws pictures in three dimensions, in half a second each; None from above.

    `reset(options={"world": 7})` chooses the world. With `campaign_seed` (and `repetition`, 0) as well, the episode is
    the very trial that `barn run --seed` makes of these numbers.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012 (Gymnasium's)

    def __init__(
        self,
        config: EnvConfig | None = None,
        render_mode: str | None = None,
        render_camera: str | None = None,
        opened: Dataset | None = None,
        **changes: object,
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ConfigError(f"render_mode must be None or {RENDER_MODES[0]!r}, got {render_mode!r}")
        if render_camera is not None and render_camera not in CAMERAS:
            known = ", ".join(CAMERAS)
            raise ConfigError(f"render_camera must be None or one of {known}, got {render_camera!r}")
        self.render_mode = render_mode
        self.render_camera = render_camera
        self.config = replace_dotted(config or EnvConfig(), changes, "environment")
        self._dataset = opened or open_dataset(self.config.dataset)
        chosen = select_worlds(self.config.worlds, self._dataset.indices)
        some = replace(self._dataset, readers={index: partial(self._dataset.load, index) for index in chosen})
        self.curriculum = Curriculum(some, None, self.config.curriculum)
        self.protocol = load_protocol(self.config.protocol)
        self._simulator = simulator_config(self.protocol, self.config.simulator, load_robot(self.config.robot))
        self._dataset.require_fit(robot_of(self._simulator), chosen)
        self._safety = self._placed(self.config.safety)
        self.encoder = ObservationEncoder(self.config.observation)
        low, high = self.config.observation.bounds()
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / self._simulator.control_period_s))}
        self._client: PhysicsClient | None = None
        self._episode: Episode | None = None
        self._picture: TopView | CameraView | None = None
        self._place: tuple[Batch, int] | None = None
        self._unseen = np.zeros(self.config.observation.size, np.float32)
        self._known: dict[int, tuple[Episode, WayLeft]] = {}  # the first episode in each world, by its number

    def join(self, batch: Batch, index: int, others: "JackalEnv") -> None:
        """Let the episodes from now on advance in a batch, instead of by `step`.

        others: an environment of the same configuration, to share with what is known of worlds.
        """
        self._place = batch, index
        self._client = PhysicsClient(idle=batch.engines)
        self._known = others._known

    @property
    def simulator_config(self) -> SimulatorConfig:
        """Configuration of the simulator."""
        return self._simulator

    @property
    def episode(self) -> Episode:
        """The episode that runs or was the last; ResetNeeded before the first."""
        if self._episode is None:
            raise gymnasium.error.ResetNeeded("reset() must be called before the first step of an episode")
        return self._episode

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Vector, dict[str, Any]]:
        """Begin an episode in the world of `options`, or in one drawn at the present level of the curriculum.

        In a batch, which reads the sensors, the observation is empty, and so is the info.
        """
        super().reset(seed=seed)
        if self._client is None:
            self._client = PhysicsClient()
        self._episode, self.way = self._begun(_checked_options(options), self._client)
        if self._place is not None:
            return self._unseen, {}
        self._left_m = self.way.metres(self._episode.sensors.truth.pose)
        self._begin_picture(self._episode)
        return self._see(), self._info()

    def step(self, action: npt.NDArray[np.floating]) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Drive for one control period; ResetNeeded before `reset` and after the end of an episode."""
        episode = self.episode
        if episode.verdict is not None:
            raise gymnasium.error.ResetNeeded("reset() must be called before the first step of an episode")
        action = np.asarray(action)
        if action.shape != (ACTIONS,):
            raise ConfigError(f"action must be an array of shape {(ACTIONS,)}, got {action.shape}")
        wanted = self.config.action.command(action)
        given = self.shielded(wanted, episode.sensors.odometry.velocity, episode.sensors.scan)
        verdict = episode.step(given)
        seen = self._see()
        before_m, self._left_m = self._left_m, self.way.metres(episode.sensors.truth.pose)
        nearest_m = float(seen[: self.config.observation.beams].min()) * self.config.observation.range_limit_m
        progress_m, period_s = before_m - self._left_m, self._simulator.control_period_s
        reward = step_reward(self.config.reward, progress_m, period_s, nearest_m, given != wanted)
        if verdict is None:
            return seen, reward, False, False, self._info()
        return seen, *self.conclude(reward, verdict), self._info()

    def conclude(self, reward: float, verdict: Verdict) -> tuple[float, bool, bool]:
        """Take note of an episode's end; return reward of its last step, whether it terminated or was truncated."""
        self.curriculum.record(verdict.outcome is Outcome.SUCCESS)
        terminated = verdict.outcome in TERMINAL
        return reward + reward_of_end(self.config.reward, verdict), terminated, not terminated

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) from above, or by `render_camera`; None without a render mode."""
        if self._episode is None or self._picture is None:
            return None
        return self._picture.draw(self._episode)

    def close(self) -> None:
        """Release the physics engine."""
        if self._client is not None:
            self._client.close()
        if self._picture is not None:
            self._picture.close()
        self._client = self._episode = self._picture = None

    def _begin_picture(self, episode: Episode) -> None:
        if self._picture is not None:
            self._picture.close()
            self._picture = None
        if self.render_mode:
            seen_by = self.render_camera
            self._picture = CameraView(episode, seen_by) if seen_by else TopView(episode)

    def _begun(self, options: Mapping[str, int], client: PhysicsClient) -> tuple[Episode, WayLeft]:
        """Return a new episode, and the way in its world; what `options` do not give is drawn."""
        index, world = self._world(options.get("world"))
        seed = options.get("campaign_seed")
        seed = int(self.np_random.integers(2**62)) if seed is None else seed
        repetition, place = options.get("repetition", 0), self._place or ()
        if index in self._known:
            known, way = self._known[index]
            return known.repeated(seed, repetition, client, *place), way
        if len(self._known) >= _MOST_KEPT:
            self._known.clear()
        spec = self._spec(index, world, seed, repetition)
        way = WayLeft(world, spec.course, self.config.reward.progress_along)
        self._known[index] = Episode.of(spec, client, *place), way
        return self._known[index]

    def _spec(self, index: int, world: World, seed: int, repetition: int) -> TrialSpec:
        return TrialSpec(
            dataset=self._dataset.name,
            index=index,
            world=world,
            planner="policy",
            preset="",
            overrides={},
            protocol=self.protocol,
            simulator=self._simulator,
            campaign_seed=seed,
            repetition=repetition,
        )

    def _world(self, index: int | None) -> tuple[int, World]:
        if index is not None:
            return index, self._dataset.load(index)
        hardest = self.curriculum.level if self.config.adaptive else 1.0
        return self.curriculum.draw(self.np_random, self.config.easiest, min(hardest, self.config.hardest))

    def shielded(self, wanted: Velocity2D, moving: Velocity2D, scan: Scan) -> Velocity2D:
        """Return the command that is given, which is the one wanted where the shield is off or has no objection."""
        if not self._safety.enabled or not wanted.is_finite():
            return wanted
        return safe_command(wanted, moving, scan, self._safety)

    def _placed(self, safety: SafetyConfig) -> SafetyConfig:
        """Return the shield for the robot, its lidar where the simulator has it; ConfigError for another place."""
        mount_m = self._simulator.lidar.mount_x_m
        if safety.lidar_x_m not in (SafetyConfig().lidar_x_m, mount_m):
            raise ConfigError(
                f"safety.lidar_x_m is {safety.lidar_x_m:g}, but the lidar is mounted at {mount_m:g} m (simulator"
                " parameter lidar.mount_x_m)"
            )
        placed = replace(safety, lidar_x_m=mount_m)
        robot = robot_of(self._simulator)
        return replace_dotted(placed, fitted(placed, robot) | lidar_place(placed, robot.lidar), "safety")

    def _see(self) -> Vector:
        assert self._episode is not None
        if self._picture is not None:
            self._picture.add(self._episode)
        return self.encoder.encode(self._episode.observation(), self._episode.spec.goal)

    def _info(self) -> dict[str, Any]:
        episode = self.episode
        info = {"world": episode.spec.index, "time_s": seconds(episode.sensors.stamp_ns), "way_left_m": self._left_m}
        return info | info_of_end(episode)


def info_of_end(episode: Episode) -> dict[str, Any]:
    """Return what `info` has of the end of an episode, nothing before."""
    verdict, scores = episode.verdict, episode.trial.scores
    if verdict is None or scores is None:
        return {}
    return {
        "outcome": verdict.outcome.value,
        "detail": verdict.detail,
        "is_success": scores.success,
        "scores": dict(vars(scores)),
    }


def _checked_options(options: Mapping[str, Any] | None) -> dict[str, int]:
    """Return the options of a reset, all of them numbers."""
    checked = {}
    for name, value in (options or {}).items():
        if name not in _OPTIONS:
            raise ConfigError(f"reset: unknown option {name!r}{suggest(name, _OPTIONS)}")
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if not whole or value < 0:
            raise ConfigError(f"reset: option {name!r} must be a whole number from 0, got {value!r}")
        checked[name] = int(value)
    return checked
