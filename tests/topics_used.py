"""Topics of the catalog that each package's nodes use, read from their source."""

import ast

from repository import ROOT

from barn_worlds.messages import topics
from barn_worlds.messages.topics import Topic

CATALOGUE = {
    name: value for name, value in vars(topics).items() if isinstance(value, Topic)
}
# What is published or named outside the nodes' own folders, and topics of which the
# evaluator knows only the type.
CORES = {
    "barn_sim": "messages.py",
    "barn_planners": "messages.py",
    "barn_eval": "live_score.py",
}
ONLY_TYPES = {"barn_eval": {topics.AMCL_POSE, topics.TF}}


def trees_of(package):
    """Return the parsed source of a package's nodes and their cores."""
    folder = ROOT / package / package
    files = [*(folder / "ros").rglob("*.py"), *folder.rglob(CORES.get(package, "none"))]
    return [ast.parse(path.read_text("utf-8")) for path in files]


def topics_of(package):
    """Return the topics of the catalog that a package's nodes publish or receive."""
    names = set()
    for node in (node for tree in trees_of(package) for node in ast.walk(tree)):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "topics"
        ):
            names.add(CATALOGUE.get(node.attr))
        elif isinstance(node, ast.ImportFrom) and node.module == topics.__name__:
            names |= {CATALOGUE.get(alias.name) for alias in node.names}
    return names - {None} - ONLY_TYPES.get(package, set())
