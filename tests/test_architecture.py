"""The rules on what may import what, held over the source of all packages."""

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from repository import ROOT

ALLOWED = {
    "barn_worlds": set(),
    "barn_sim": {"barn_worlds"},
    "barn_planners": {"barn_worlds"},
    "barn_metrics": {"barn_worlds"},
    "barn_eval": {"barn_worlds", "barn_sim", "barn_planners", "barn_metrics"},
}
MESSAGES = ("_msgs", "_interfaces", "_srvs")
ROS = {"rclpy", "tf2_ros", "rosbag2_py", "launch", "launch_ros", "ament_index_python"}
WALL_CLOCKS = {
    "time",
    "perf_counter",
    "monotonic",
    "time_ns",
    "perf_counter_ns",
    "monotonic_ns",
    "now",
    "today",
}
# What runs trials measures how long they take; what only judges or computes reads no
# clock.
MEASURING = tuple(
    f"barn_eval/{name}" for name in ("results/", "running/", "studies/", "commands/")
)
SEEDED = {"SeedSequence", "default_rng", "PCG64", "PCG64DXSM", "Philox", "SFC64"}
RANDOM = {"Generator", "BitGenerator"} | SEEDED
UNSAFE = {
    "os.system",
    "eval",
    "exec",
    "yaml.unsafe_load",
    "yaml.full_load",
    "pickle.load",
    "pickle.loads",
}


@dataclass(frozen=True)
class Source:
    """A source file of a package, parsed."""

    package: str
    where: str
    tree: ast.Module

    @property
    def ros(self):
        """Whether this is where ROS may be known.

        Nodes, what only they need, and launch files.
        """
        parts = Path(self.where).parts
        return parts[0] == "launch" or "ros" in parts

    @property
    def imports(self):
        """The dotted name of everything that the file imports, wherever in it."""
        names: set[str] = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
        for call in self.calls():
            is_import = ast.unparse(call.func).endswith(("import_module", "__import__"))
            if is_import and call.args and isinstance(call.args[0], ast.Constant):
                names.add(call.args[0].value)
        return names

    @property
    def tops(self):
        """The packages that the file imports."""
        return {name.split(".")[0] for name in self.imports}

    def calls(self):
        """Yield all calls."""
        return (node for node in ast.walk(self.tree) if isinstance(node, ast.Call))


@cache
def sources():
    """Return the source files of all packages, tests and setup left out."""
    files = []
    for package in ALLOWED:
        folder = ROOT / package
        modules = sorted((folder / package).rglob("*.py"))
        for path in modules + sorted(folder.glob("launch/*.py")):
            where = str(path.relative_to(ROOT / package))
            files.append(Source(package, where, ast.parse(path.read_text("utf-8"))))
    return tuple(files)


def test_the_source_is_looked_at():
    assert {source.package for source in sources()} == set(ALLOWED)
    assert len(sources()) > 80
    everything = {(source.package, top) for source in sources() for top in source.tops}
    assert {("barn_sim", "pybullet"), ("barn_sim", "rclpy")} <= everything
    assert ("barn_eval", "barn_metrics") in everything


def test_packages_import_only_what_is_below_them():
    for source in sources():
        others = set(ALLOWED) - {source.package} - ALLOWED[source.package]
        assert not source.tops & others, source.where


def test_only_nodes_and_launch_files_know_ros():
    for source in sources():
        tops = () if source.ros else source.tops
        known = [top for top in tops if top in ROS or top.endswith(MESSAGES)]
        assert not known, source.where


# The rooms of barn_eval, folders and files at its root, from the lowest to the highest;
# each imports only those below.
ROOMS = (
    "trials",
    "results",
    "running",
    "verification",
    "ros",
    "analysis",
    "pages",
    "learning",
    "studies",
    "api",
    "gym",
    "commands",
)
# `barn.results` is the room of folders, and offers Python users what reads them.
FORWARDED = "barn_eval/results/__init__.py barn_eval.api.results"
ENTRANCES = ("__init__", "__main__")  # which import what they offer by name


# The parts of barn_sim, likewise.
SIMULATOR_PARTS = (
    "config",
    "seeds",
    "body",
    "contact",
    "sensors",
    "motion",
    "simulator",
    "batch",
    "messages",
    "drawing",
    "ros",
)


@pytest.mark.parametrize(
    "package, parts", [("barn_eval", ROOMS), ("barn_sim", SIMULATOR_PARTS)]
)
def test_parts_of_a_package_import_only_parts_below_them(package, parts):
    wrong = []
    for source in sources():
        if source.package != package or source.where.startswith("launch"):
            continue
        part = Path(source.where).with_suffix("").parts[1]
        if part in ENTRANCES:
            continue
        below = (*parts[: parts.index(part) + 1], "__version__")
        for name in source.imports:
            top, *others = name.split(".")
            if f"{source.where} {name}" == FORWARDED:
                continue
            if top == package and others and others[0] not in below:
                wrong.append(f"{source.where} imports {name}")
    assert not wrong


def test_the_documentation_has_the_rooms_in_their_order():
    page = ROOT / "docs" / "architecture.md"
    section = page.read_text("utf-8").partition("## Parts of barn_eval")[2]
    assert tuple(re.findall(r"(?m)^\| `(\w+)` \|", section)) == ROOMS
    named = re.findall(r"`(barn_\w+/[\w/]+\.py)`", section)
    assert len(named) > 20
    missing = [file for file in named if not (ROOT / file).is_file()]
    assert missing == []


def test_cores_do_not_import_nodes():
    for source in sources():
        # the rooms of barn_eval have an order of their own
        if source.ros or source.package == "barn_eval":
            continue
        for name in source.imports:
            top, *rooms = name.split(".")
            assert top not in ALLOWED or rooms[:1] != ["ros"], source.where


def test_heavy_libraries_stay_in_their_place():
    for source in sources():
        assert "pybullet" not in source.tops or source.package == "barn_sim"
        assert "torch" not in source.tops


def test_there_is_no_global_random_state():
    """Only generators made from a seed.

    Nothing but their constructors is taken from numpy.random.
    """
    for source in sources():
        assert "random" not in source.tops, source.where
        for node in ast.walk(source.tree):
            if isinstance(node, ast.Attribute):
                of_numpy = ast.unparse(node.value) in ("np.random", "numpy.random")
                is_good = not of_numpy or node.attr in RANDOM
                assert is_good, f"{source.where}:{node.lineno}"
        for call in source.calls():
            is_seeded = call.args or call.keywords
            constructor = ast.unparse(call.func).split(".")[-1]
            is_good = is_seeded or constructor not in SEEDED
            assert is_good, f"{source.where}:{call.lineno} without a seed"


def test_cores_read_no_clock():
    """Time is passed in, except where trials are run and their duration is measured."""
    wrong = []
    for source in sources():
        if source.ros or source.where.startswith(MEASURING):
            continue
        for call in source.calls():
            name = ast.unparse(call.func)
            parts = name.split(".")
            if parts[-1] in WALL_CLOCKS and parts[0] in ("time", "datetime", "date"):
                wrong.append(f"{source.where}:{call.lineno} {name}")
    assert not wrong


def test_user_strings_meet_no_shell_and_no_unsafe_loader():
    wrong = []
    for source in sources():
        for call in source.calls():
            name = ast.unparse(call.func)
            options = {word.arg: ast.unparse(word.value) for word in call.keywords}
            pickle = options.get("allow_pickle")
            is_unsafe = name in UNSAFE or "True" in (options.get("shell"), pickle)
            if is_unsafe or (name == "np.load" and pickle != "False"):
                wrong.append(f"{source.where}:{call.lineno} {name}")
    assert not wrong
