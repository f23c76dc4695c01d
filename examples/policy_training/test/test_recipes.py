"""The recipes of the README run as they are shown: `pytest -m slow`."""

import os
import re
from pathlib import Path

import pytest
from waiting import run_python

from barn_planners.policy.file import read_policy

PACKAGE = Path(__file__).resolve().parents[1]
SHOWN = re.findall(
    r'(?ms)^```python title="(\w+).py"\n(.*?)^```', (PACKAGE / "README.md").read_text()
)


@pytest.mark.slow
@pytest.mark.parametrize("name, recipe", SHOWN[1:])
def test_a_recipe_writes_a_policy(name, recipe, tmp_path):
    for module in re.findall(r"(?m)^from ((?:ray|torchrl|stable_)\S*)", recipe):
        pytest.importorskip(module, exc_type=ImportError)
    (tmp_path / "out").mkdir()
    path = os.pathsep.join([str(PACKAGE.parent), os.environ.get("PYTHONPATH", "")])
    for text in (SHOWN[0][1], recipe):
        (tmp_path / "shown.py").write_text(text)
        environment = os.environ | {"PYTHONPATH": path}
        run_python("shown.py", cwd=tmp_path, env=environment)
    assert read_policy(tmp_path / "out" / f"{name}.npz").layers[-1] == 2
