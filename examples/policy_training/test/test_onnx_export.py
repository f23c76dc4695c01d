"""Modules as ONNX files answer as the modules."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript", reason="onnxscript is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from policy_training.onnx_export import export_onnx  # noqa: E402

from barn_eval.learning.config import EnvConfig  # noqa: E402
from barn_planners.policy.space import PolicyObservation  # noqa: E402

CONFIG = EnvConfig(observation=PolicyObservation(beams=10))


class Recurrent(torch.nn.Module):
    """A cell with a memory, and a layer that acts."""

    def __init__(self):
        super().__init__()
        self.cell = torch.nn.GRUCell(CONFIG.observation.size, 8)
        self.head = torch.nn.Linear(8, 2)

    def forward(self, observation, state):
        state = self.cell(observation, state)
        return self.head(state), state


def test_a_recurrent_module_answers_as_its_file(tmp_path):
    torch.manual_seed(0)
    module = Recurrent()
    network = export_onnx(module, CONFIG, tmp_path / "policy.onnx", state_sizes=[8])
    assert (network.observation, network.action) == (CONFIG.observation, CONFIG.action)
    state = torch.zeros(1, 8)
    rng = np.random.default_rng(0)
    for _ in range(5):
        vector = rng.uniform(-1.0, 1.0, CONFIG.observation.size).astype(np.float32)
        with torch.no_grad():
            action, state = module(torch.from_numpy(vector[None]), state)
        np.testing.assert_allclose(network.act(vector), action[0].numpy(), atol=1e-5)
