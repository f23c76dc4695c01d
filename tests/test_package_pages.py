"""Each package's page has every topic with its type and every service of its nodes."""

import ast
import re

import pytest
from repository import ROOT
from topics_used import CATALOGUE, topics_of, trees_of

NODES = [
    path
    for path in sorted(ROOT.glob("barn_*/README.md"))
    if (path.parent / path.parent.name / "ros").is_dir()
]


def services_of(package):
    """Return the names of the services that a package's nodes offer."""
    names = set()
    # the simulator's node offers its own through a method that all of them share
    methods = (".create_service", "._add_service")
    for node in (node for tree in trees_of(package) for node in ast.walk(tree)):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(methods):
            name = node.args[1]
            if isinstance(name, ast.Constant):
                names.add(f"~/{name.value.removeprefix('~/')}")
    return names


def rows_of(text):
    """Return the rows of a page's tables of topics.

    Name, with a slash in front, to the cells behind it.
    """
    rows = {}
    for table in re.findall(
        r"^\| topic \|.*\n\| ---.*\n((?:\|.*\n)+)", text, re.MULTILINE
    ):
        for line in table.splitlines():
            names, *cells = line.strip("| ").split(" | ")
            rows |= {
                "/" + name.lstrip("/"): " | ".join(cells)
                for name in re.findall(r"`([^`]+)`", names)
            }
    return rows


@pytest.mark.parametrize("page", NODES, ids=lambda path: path.parent.name)
def test_every_service_and_topic_with_its_type_is_on_the_page(page):
    text = page.read_text("utf-8")
    package = page.parent.name
    rows = rows_of(text)
    used = topics_of(package)
    assert len(used) > 1
    assert {topic.path for topic in used} <= set(rows)
    wrong = {
        topic.path
        for topic in used
        if topic.type_name.rpartition("/")[2] not in rows[topic.path]
        and "as the simulator has" not in rows[topic.path]
    }
    assert wrong == set()
    assert set(rows) <= {topic.path for topic in CATALOGUE.values()}
    assert {name for name in services_of(package) if f"`{name}`" not in text} == set()


def test_the_page_of_topics_names_all_and_no_other():
    rows = rows_of((ROOT / "docs/topics.md").read_text("utf-8"))
    assert set(rows) == {topic.path for topic in CATALOGUE.values()}
