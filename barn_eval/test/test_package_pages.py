"""Each package's page has every topic, service and parameter of its nodes."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from barn_worlds.reference import parameter_table

ROOT = Path(__file__).resolve().parents[2]
MAKES = {"create_publisher": 1, "create_subscription": 1, "_listen": 1, "subscribe": 0, "create_service": 1}
NODES = [path for path in sorted(ROOT.glob("barn_*/README.md")) if (path.parent / path.parent.name / "ros").is_dir()]


def names_in(package):
    """Return the names of topics and services that a package's nodes offer or use, where they stand as texts."""
    found = set()
    for path in (ROOT / package / package / "ros").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            place = MAKES.get(node.func.attr)
            if place is None or len(node.args) <= place:
                continue
            name = node.args[place]
            if isinstance(name, ast.Constant) and isinstance(name.value, str):
                found.add(name.value)
    return found


@pytest.mark.parametrize("page", NODES, ids=lambda path: path.parent.name)
def test_every_topic_and_service_is_on_the_page(page):
    text = page.read_text("utf-8")
    quoted = set(re.findall(r"`([^`\s]+)`", text))
    names = names_in(page.parent.name)
    assert names
    missing = {name for name in names if not {name, name.lstrip("/"), "/" + name.lstrip("/")} & quoted}
    assert missing == set()


def test_every_parameter_has_a_row_with_default_unit_and_range():
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from barn_planners.ros.planner import NodeConfig  # noqa: PLC0415
    from barn_planners.sync import SyncConfig  # noqa: PLC0415
    from barn_worlds.ros.map_server import MapServerConfig  # noqa: PLC0415

    for package, config in (
        ("barn_planners", NodeConfig()),
        ("barn_planners", SyncConfig()),
        ("barn_worlds", MapServerConfig()),
    ):
        text = (ROOT / package / "README.md").read_text("utf-8")
        rows = parameter_table({"default": config}).splitlines()[2:]
        assert [row for row in rows if row not in text] == []
