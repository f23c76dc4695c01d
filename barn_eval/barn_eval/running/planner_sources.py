"""What the source of a planner says before it runs: imports, parameters, its start.

Files are parsed and never executed; data/modules.json says what supplies modules.
"""

import ast
import re
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from barn_eval.running.planner_choices import split_command
from barn_eval.running.planner_packages import find_module, find_packaged
from barn_worlds.base.files import read_json

_SUPPLIERS = read_json(Path(__file__).parents[1] / "data" / "modules.json")
_GOAL_PARAMETER = re.compile(
    r"declare_parameter\(\s*.(\w*(?:goal|target)\w*_(x|y|yaw))\b"
)
_RUNS = re.compile(r"^(if |main\(|\w+\.\w+\()", re.MULTILINE)
# Prints the names that a Python cannot import.
_FIND = (
    "import sys, importlib.util as util\n"
    "print(*[name for name in sys.argv[1:] if util.find_spec(name) is None])"
)


@dataclass(frozen=True)
class PlannerSource:
    """The Python files of a planner command, as far as they are known."""

    # Python that runs it, empty if it is no Python.
    python: str = ""
    # Files that are started, and the folders that their own modules lie in.
    starts: tuple[Path, ...] = ()
    folders: tuple[Path, ...] = ()

    def read(self) -> tuple[dict[Path, str], set[str]]:
        """Return texts of its own files, and top-level names of all other modules."""
        texts: dict[Path, str] = {}
        modules: set[str] = set()
        queue = list(self.starts)
        while queue:
            path = queue.pop()
            if path in texts or not path.is_file():
                continue
            texts[path] = path.read_text("utf-8", "replace")
            for name, folders in _imports(texts[path], path, self.folders):
                module = find_module(name, folders)
                if module is not None:
                    queue.append(module)
                # A relative import may also name what its package defines.
                elif folders == self.folders and not any(
                    (folder / name).exists() for folder in folders
                ):
                    modules.add(name)
        return texts, {name for name in modules if "." not in name}

    def missing_modules(self, environment: Mapping[str, str]) -> dict[str, str]:
        """Run its Python; return what supplies modules that it cannot find, by name.

        Args:
            environment: Variables that the planner is started with.
        """
        _, names = self.read()
        if not names:
            return {}
        search = subprocess.run(  # noqa: S603
            [self.python, "-c", _FIND, *sorted(names)],
            env=dict(environment),
            capture_output=True,
            text=True,
            check=False,
        )
        return {name: supplier(name) for name in search.stdout.split()}

    def goal_arguments(self) -> str:
        """Return ROS arguments with placeholders for its goal parameters, or ""."""
        texts, _ = self.read()
        arguments = ""
        for name, number in _GOAL_PARAMETER.findall("\n".join(texts.values())):
            arguments += f" -p {name}:={{goal_{number}}}"
        return arguments and f" --ros-args{arguments}"

    def start_problem(self) -> str:
        """Return a line if a script defines main but never calls it, else ""."""
        texts, _ = self.read()
        for start in self.starts:
            text = texts.get(start, "")
            if "def main(" in text and not _RUNS.search(text):
                return (
                    f"{start} only defines main and does not call it: start it by"
                    f" --planner-package {start}:main"
                )
        return ""


def read_source(command: str) -> PlannerSource:
    """Return a command's Python source, empty for other programs; ConfigError if wrong.

    Raises:
        ConfigError: If the command names a package without that executable.
    """
    words = split_command(command)
    executable = find_packaged(words)
    if executable is not None:
        folders = tuple(executable.import_path)
        starts = tuple(executable.sources())
        return PlannerSource(executable.command[0], starts, folders)
    scripts = [Path(word) for word in words[1:] if word.endswith(".py")]
    if not re.fullmatch(r"python[\d.]*", Path(words[0]).name) or not scripts:
        return PlannerSource()
    return PlannerSource(words[0], (scripts[0],), (scripts[0].parent,))


def supplier(module: str) -> str:
    """Return a line on what supplies a module, or that it is not known here."""
    package = module.partition(".")[0]
    for pattern, text in _SUPPLIERS.items():
        if re.fullmatch(pattern, package):
            return str(text).format(name=package.replace("_", "-"))
    # Python names the first part of a dotted name that it cannot find.
    if package != module:
        return f"the package {package} does not contain it"
    # Packages of that name on PyPI may be something else.
    return "not known here; see the planner's own page"


def explain_end(command: str, printed: str) -> str:
    """Return why a planner ended at its start and what to type, empty if unknown.

    Args:
        command: The planner command.
        printed: The end of what it printed.
    """
    match = re.search(r"No module named '([\w.]+)", printed)
    if match:
        return f"the module {match[1]} is missing: {supplier(match[1])}"
    if "EOFError" in printed:
        return (
            "it asks for input: --planner-input '{goal_x} {goal_y}', or"
            " '{goal_x}\\n{goal_y}' if it asks for one number at a time"
        )
    return "" if "Error" in printed else read_source(command).start_problem()


def _imports(
    text: str, path: Path, folders: tuple[Path, ...]
) -> Iterator[tuple[str, tuple[Path, ...]]]:
    """Yield (module, folders to look in) of a file's imports, except those in a `try`.

    Modules in a `try` are left out, since the file may do without them.
    """
    try:
        nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError):
        # Python itself says what is wrong once the planner starts.
        return
    optional: set[ast.AST] = set()
    for node in nodes:
        if isinstance(node, ast.Try):
            optional.update(ast.walk(node))
    for node in nodes:
        if node in optional:
            continue
        match node:
            case ast.Import(aliases):
                names = [alias.name for alias in aliases]
                where = folders
            case ast.ImportFrom(module, aliases, level):
                prefix = f"{module}." if module else ""
                names = [prefix + alias.name for alias in aliases]
                where = (path.parents[level - 1],) if level else folders
            case _:
                continue
        for name in names:
            # A package first, which may import modules of its own.
            parts = name.split(".")
            for end in range(1, len(parts) + 1):
                yield ".".join(parts[:end]), where
