"""From a model of Stable-Baselines3 to a policy file that answers as the model does; and the training script."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium")
algorithms = pytest.importorskip("stable_baselines3")

from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

from barn_eval.learning.config import EnvConfig  # noqa: E402
from barn_eval.learning.environment import JackalEnv  # noqa: E402
from barn_eval.learning.stable_baselines import export_policy  # noqa: E402
from barn_planners.policy.file import PolicyError, PolicyNetwork, read_policy  # noqa: E402
from barn_planners.policy.space import PolicyAction, PolicyObservation  # noqa: E402
from barn_worlds.base.errors import ConfigError  # noqa: E402

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "train_policy.py"
CONFIG = EnvConfig(worlds="0", observation=PolicyObservation(beams=12), action=PolicyAction(0.0, 1.0, 1.0))


@pytest.fixture
def vectorised():
    envs = DummyVecEnv([lambda: JackalEnv(CONFIG)])
    yield envs
    envs.close()


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("PPO", {}),
        ("PPO", {"policy_kwargs": {"net_arch": [16, 16, 16]}}),
        ("PPO", {"policy_kwargs": {"net_arch": []}}),
        ("A2C", {}),
        ("SAC", {"buffer_size": 10, "policy_kwargs": {"net_arch": [16, 16]}}),
        ("TD3", {"buffer_size": 10, "policy_kwargs": {"net_arch": [16, 16]}}),
    ],
)
def test_the_file_answers_as_the_model(vectorised, tmp_path, name, settings):
    model = getattr(algorithms, name)("MlpPolicy", vectorised, seed=1, device="cpu", **settings)
    export_policy(model, CONFIG, tmp_path / "policy.npz", {"by": "a test"})
    policy = read_policy(tmp_path / "policy.npz")
    assert (policy.observation, policy.action) == (CONFIG.observation, CONFIG.action)
    assert policy.about == {"algorithm": name, "steps": 0, "by": "a test"}
    low, high = CONFIG.observation.bounds()
    network = PolicyNetwork(policy)
    for seen in np.random.default_rng(2).uniform(low, high, (50, CONFIG.observation.size)).astype(np.float32):
        expected, _ = model.predict(seen, deterministic=True)
        np.testing.assert_allclose(np.clip(network.act(seen), -1.0, 1.0), expected, atol=1e-5)


def test_what_a_file_cannot_hold_is_refused(vectorised, tmp_path):
    path = tmp_path / "policy.npz"
    model = algorithms.PPO("MlpPolicy", VecNormalize(vectorised), device="cpu")
    with pytest.raises(ConfigError, match="norm_obs=False"):
        export_policy(model, CONFIG, path)
    torch = pytest.importorskip("torch")
    model = algorithms.PPO("MlpPolicy", vectorised, policy_kwargs={"activation_fn": torch.nn.ELU}, device="cpu")
    with pytest.raises(ConfigError, match="linear layers with one of Tanh, ReLU between, got Linear, ELU"):
        export_policy(model, CONFIG, path)
    model = algorithms.PPO("MlpPolicy", vectorised, device="cpu")
    with pytest.raises(PolicyError, match="must lead from 725 observed values"):
        export_policy(model, EnvConfig(), path)
    assert not path.exists()


@pytest.mark.skipif(not EXAMPLE.is_file(), reason="the repository's examples are not beside this package")
def test_the_training_script_trains_draws_and_compares(tmp_path):
    command = [sys.executable, EXAMPLE, *["--steps", "1", "--environments", "8", "--held-out", "1", "--out"], tmp_path]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert ended.stdout.count("held-out worlds") == 3
    with (tmp_path / "curve.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert int(row["steps"]) == 8192 and int(row["episodes"]) > 0
    assert (tmp_path / "curve.png").stat().st_size > 1000
    untrained, trained = read_policy(tmp_path / "untrained.npz"), read_policy(tmp_path / "policy.npz")
    assert trained.about["steps"] == 8192
    assert not np.array_equal(untrained.weights[0], trained.weights[0])
