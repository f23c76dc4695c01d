"""Export a model of Stable-Baselines3 to a policy file that answers as the model does.

The training script is tested, too.
"""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from waiting import run_python

gymnasium = pytest.importorskip("gymnasium")
algorithms = pytest.importorskip("stable_baselines3")

from policy_training.curriculum import CurriculumConfig  # noqa: E402
from policy_training.stable_baselines import StableBatch, export_policy  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

from barn_eval.learning.config import EnvConfig  # noqa: E402
from barn_eval.learning.environment import JackalEnv  # noqa: E402
from barn_planners.policy.file import PolicyError, PolicyNetwork, read_policy  # noqa: E402
from barn_planners.policy.space import PolicyAction, PolicyObservation  # noqa: E402
from barn_worlds.base.errors import ConfigError  # noqa: E402

MANY_WORLDS = EnvConfig(
    worlds="0:300:7",
    simulator={"lidar.beams": 90},
    observation=PolicyObservation(beams=40),
)
EXAMPLE = Path(__file__).resolve().parents[2] / "train_policy.py"
CONFIG = EnvConfig(
    worlds="0",
    observation=PolicyObservation(beams=12),
    action=PolicyAction(0.0, 1.0, 1.0),
)


@pytest.fixture
def vectorised():
    envs = DummyVecEnv([lambda: JackalEnv(CONFIG)])
    yield envs
    envs.close()


def test_the_batch_gives_what_the_environments_give():
    batch = StableBatch(5, MANY_WORLDS)
    environments = DummyVecEnv([lambda: JackalEnv(MANY_WORLDS)] * 5)
    for envs in (batch, environments):
        envs.seed(3)
    np.testing.assert_array_equal(batch.reset(), environments.reset())
    ended = 0
    for action in np.full((120, 5, 2), [1.0, 0.0]):
        observations, rewards, dones, infos = batch.step(action)
        expected_observations, rewards_too, dones_too, infos_too = environments.step(
            action
        )
        np.testing.assert_array_equal(observations, expected_observations)
        np.testing.assert_array_equal(rewards, rewards_too)
        np.testing.assert_array_equal(dones, dones_too)
        for k in np.flatnonzero(dones):
            ended += 1
            for name in ("TimeLimit.truncated", "outcome", "is_success"):
                assert infos[k][name] == infos_too[k][name]
            np.testing.assert_array_equal(
                infos[k]["terminal_observation"], infos_too[k]["terminal_observation"]
            )
    assert ended > 2 and batch.env_is_wrapped(gymnasium.Wrapper) == [False] * 5
    assert batch.get_attr("render_mode", [0]) == [None]
    batch.close()
    environments.close()


def test_a_batch_takes_harder_worlds_with_success():
    batch = StableBatch(
        3, MANY_WORLDS, CurriculumConfig(first_level=0.0, window=1, promotion_rate=0.0)
    )
    batch.seed(3)
    batch.reset()
    assert {env.worlds for env in batch.envs} == {(0,)}
    ended = np.zeros(3, int)
    for _ in range(120):
        ended += batch.step(np.full((3, 2), [1.0, 0.0]))[2]
    assert [curriculum.level for curriculum in batch.curricula] == pytest.approx(
        0.05 * ended
    ) and ended.any()
    batch.close()


ALGORITHMS = """
- [PPO, {}]
- [PPO, {policy_kwargs: {net_arch: [16, 16, 16]}}]
- [PPO, {policy_kwargs: {net_arch: []}}]
- [A2C, {}]
- [SAC, {buffer_size: 10, policy_kwargs: {net_arch: [16, 16]}}]
- [TD3, {buffer_size: 10, policy_kwargs: {net_arch: [16, 16]}}]
"""


@pytest.mark.parametrize("name, settings", yaml.safe_load(ALGORITHMS))
def test_the_file_answers_as_the_model(vectorised, tmp_path, name, settings):
    model = getattr(algorithms, name)(
        "MlpPolicy", vectorised, seed=1, device="cpu", **settings
    )
    export_policy(model, CONFIG, tmp_path / "policy.npz", {"by": "a test"})
    policy = read_policy(tmp_path / "policy.npz")
    assert (policy.observation, policy.action) == (CONFIG.observation, CONFIG.action)
    assert policy.about == {"algorithm": name, "steps": 0, "by": "a test"}
    low, high = CONFIG.observation.bounds()
    network = PolicyNetwork(policy)
    for observation in (
        np.random.default_rng(2)
        .uniform(low, high, (50, CONFIG.observation.size))
        .astype(np.float32)
    ):
        expected, _ = model.predict(observation, deterministic=True)
        np.testing.assert_allclose(
            np.clip(network.act(observation), -1.0, 1.0), expected, atol=1e-5
        )


def test_normalized_observations_fold_into_the_first_layer(vectorised, tmp_path):
    normalized = VecNormalize(vectorised, clip_obs=1000.0)
    rng = np.random.default_rng(3)
    size = CONFIG.observation.size
    normalized.obs_rms.mean = rng.normal(size=size)
    normalized.obs_rms.var = rng.uniform(0.1, 2.0, size)
    model = algorithms.PPO("MlpPolicy", normalized, seed=1, device="cpu")
    network = PolicyNetwork(export_policy(model, CONFIG, tmp_path / "policy.npz"))
    for observation in rng.uniform(-1.0, 1.0, (20, size)).astype(np.float32):
        seen = normalized.normalize_obs(observation)
        expected, _ = model.predict(seen, deterministic=True)
        action = np.clip(network.act(observation), -1.0, 1.0)
        np.testing.assert_allclose(action, expected, atol=1e-4)
    normalized.clip_obs = 1.0
    with pytest.warns(UserWarning, match="entries of an observation may be clipped"):
        export_policy(model, CONFIG, tmp_path / "policy.npz")


def test_what_a_file_cannot_hold_is_refused(vectorised, tmp_path):
    path = tmp_path / "policy.npz"
    torch = pytest.importorskip("torch")
    model = algorithms.PPO(
        "MlpPolicy",
        vectorised,
        policy_kwargs={"activation_fn": torch.nn.ELU},
        device="cpu",
    )
    with pytest.raises(
        ConfigError,
        match="linear layers with one of Tanh, ReLU between, got Linear, ELU",
    ):
        export_policy(model, CONFIG, path)
    model = algorithms.PPO("MlpPolicy", vectorised, device="cpu")
    with pytest.raises(PolicyError, match="must lead from 725 observed values"):
        export_policy(model, EnvConfig(), path)
    assert not path.exists()


def test_the_training_script_trains_draws_and_compares(tmp_path):
    options = [
        "--steps",
        "1",
        "--environments",
        "8",
        "--worlds-per-set",
        "2",
        "--held-out",
        "1",
        "--out",
    ]
    ended = run_python(EXAMPLE, *options, tmp_path)
    assert ended.stdout.count("held-out worlds") == 3
    with (tmp_path / "curve.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert int(row["steps"]) == 8192 and int(row["episodes"]) > 0
    assert (tmp_path / "curve.png").stat().st_size > 1000
    untrained = read_policy(tmp_path / "untrained.npz")
    trained = read_policy(tmp_path / "policy.npz")
    assert trained.about["steps"] == 8192
    assert not np.array_equal(untrained.weights[0], trained.weights[0])
