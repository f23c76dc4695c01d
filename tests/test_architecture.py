"""The rules on what may import what, held over the source of all packages."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
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
    def ros(self) -> bool:
        """Whether this is where ROS may be known.

        Nodes, what only they need, and launch files.
        """
        parts = Path(self.where).parts
        return parts[0] == "launch" or "ros" in parts

    @property
    def imports(self) -> set[str]:
        """The dotted name of everything that the file imports, wherever in it."""
        names: set[str] = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
                ("import_module", "__import__")
            ):
                names |= {
                    argument.value
                    for argument in node.args[:1]
                    if isinstance(argument, ast.Constant)
                }
        return names

    @property
    def tops(self) -> set[str]:
        """The packages that the file imports."""
        return {name.split(".")[0] for name in self.imports}

    def calls(self) -> Iterator[ast.Call]:
        """Yield all calls."""
        return (node for node in ast.walk(self.tree) if isinstance(node, ast.Call))


@cache
def sources() -> tuple[Source, ...]:
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
    assert {
        ("barn_sim", "pybullet"),
        ("barn_sim", "rclpy"),
        ("barn_eval", "barn_metrics"),
    } <= everything


def test_packages_import_only_what_is_below_them():
    wrong = [
        f"{source.where} imports {top}"
        for source in sources()
        for top in source.tops
        & set(ALLOWED) - {source.package} - ALLOWED[source.package]
    ]
    assert not wrong


def test_only_nodes_and_launch_files_know_ros():
    wrong = [
        f"{source.where} imports {top}"
        for source in sources()
        if not source.ros
        for top in source.tops
        if top in ROS or top.endswith(MESSAGES)
    ]
    assert not wrong


# The rooms of barn_eval, folders and files at its root, from the lowest to the highest;
# each imports only those below.
ROOMS = (
    *("trials", "results", "running", "verification", "ros"),
    *("analysis", "pages", "learning", "studies", "api", "gym", "commands"),
)
# `barn.results` is the room of folders, and offers Python users what reads them.
FORWARDED = "barn_eval/results/__init__.py barn_eval.api.results"
ENTRANCES = ("__init__", "__main__")  # which import what they offer by name


def test_rooms_import_only_rooms_below_them():
    wrong = []
    for source in (
        file
        for file in sources()
        if file.package == "barn_eval" and not file.where.startswith("launch")
    ):
        room = Path(source.where).with_suffix("").parts[1]
        if room in ENTRANCES:
            continue
        level = ROOMS.index(room)
        below = (*ROOMS[: level + 1], "__version__")
        for name in source.imports:
            top, *rooms = name.split(".")
            if f"{source.where} {name}" == FORWARDED:
                continue
            if top == "barn_eval" and rooms and rooms[0] not in below:
                wrong.append(f"{source.where} imports {name}")
    assert not wrong


# The parts of barn_sim, likewise.
SIMULATOR_PARTS = (
    *("seeds", "config", "body", "contact", "sensors", "motion", "simulator"),
    *("batch", "messages", "drawing", "ros"),
)


def test_parts_of_the_simulator_import_only_parts_below_them():
    wrong = []
    for source in sources():
        if source.package != "barn_sim" or source.where.startswith("launch"):
            continue
        part = Path(source.where).with_suffix("").parts[1]
        if part in ENTRANCES:
            continue
        below = SIMULATOR_PARTS[: SIMULATOR_PARTS.index(part) + 1]
        for name in source.imports:
            top, *parts = name.split(".")
            if top == "barn_sim" and parts[0] not in below:
                wrong.append(f"{source.where} imports {name}")
    assert not wrong


def test_the_documentation_has_the_rooms_in_their_order():
    page = ROOT / "docs" / "architecture.md"
    section = page.read_text("utf-8").partition("## The rooms of barn_eval")[2]
    assert tuple(re.findall(r"(?m)^\| `(\w+)` \|", section)) == ROOMS
    named = re.findall(r"`(barn_\w+/[\w/]+\.py)`", section)
    assert len(named) > 20
    missing = [file for file in named if not (ROOT / file).is_file()]
    assert missing == []


def test_cores_do_not_import_nodes():
    wrong = [
        f"{source.where} imports {name}"
        for source in sources()
        if not source.ros
        and source.package != "barn_eval"  # whose rooms have an order of their own
        for name in source.imports
        if name.split(".")[0] in ALLOWED and name.split(".")[1:2] == ["ros"]
    ]
    assert not wrong


def test_heavy_libraries_stay_in_their_place():
    assert not [
        file.where
        for file in sources()
        if "pybullet" in file.tops and file.package != "barn_sim"
    ]
    assert not [file.where for file in sources() if "torch" in file.tops]


def test_there_is_no_global_random_state():
    """Only generators made from a seed.

    Nothing but their constructors is taken from numpy.random.
    """
    wrong = [
        f"{source.where} imports random"
        for source in sources()
        if "random" in source.tops
    ]
    for source in sources():
        for node in ast.walk(source.tree):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) in (
                "np.random",
                "numpy.random",
            ):
                wrong += (
                    []
                    if node.attr in RANDOM
                    else [f"{source.where}:{node.lineno} {node.attr}"]
                )
        for call in source.calls():
            unseeded = not call.args and not call.keywords
            if unseeded and ast.unparse(call.func).split(".")[-1] in SEEDED:
                wrong.append(
                    f"{source.where}:{call.lineno} {ast.unparse(call.func)} without a seed"
                )
    assert not wrong


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
            options = {
                keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords
            }
            unsafe = (
                name in UNSAFE
                or options.get("shell") == "True"
                or options.get("allow_pickle") == "True"
            )
            if unsafe or (name == "np.load" and options.get("allow_pickle") != "False"):
                wrong.append(f"{source.where}:{call.lineno} {name}")
    assert not wrong
