"""Setup and launch files of packages that nobody built: what they install and start.

Of the nodes that a launch file starts, only those of the packages at hand are taken:
simulators, bridges and viewers of others have no place in a trial.
"""

import ast
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from barn_worlds.base.errors import ConfigError

LAUNCHES = "def generate_launch_description("
"""What a launch file has and other scripts do not."""

_SHARES = frozenset(["get_package_share_directory", "FindPackageShare", "find"])
_JOINS = frozenset(["join", "PathJoinSubstitution"])
# Calls around a value that do not change it.
_WRAPPERS = frozenset(["ParameterValue", "ParameterFile", "str", "IfCondition"])
_TRUE = ("true", "1")

LaunchedNode = tuple[str, str, tuple[str, ...]]
"""Package, executable, and its arguments, those of ROS included."""


@dataclass
class SourceFile:
    """A file in Python that is parsed and never executed."""

    path: Path
    # Folders of the packages at hand, by name.
    packages: Mapping[str, Path] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Parse the file, collect values and defaults; ConfigError if no Python."""
        try:
            self.tree = ast.parse(self.path.read_bytes())
        except (OSError, SyntaxError, ValueError) as error:
            raise ConfigError(f"{self.path}: {error}") from None
        # Expressions by the name that they are assigned to, and defaults of arguments.
        self.values: dict[str, ast.expr] = {}
        self.defaults: dict[str, ast.expr | None] = {}
        for item in ast.walk(self.tree):
            match item:
                case ast.Assign([ast.Name(name)], value):
                    self.values[name] = value
                case ast.Call(args=[ast.Constant(str(name)), *_]) if (
                    _function(item) == "DeclareLaunchArgument"
                ):
                    self.defaults[name] = _keyword(item, "default_value")

    def entries(self, key: str) -> Iterator[str]:
        """Yield texts under a key of dictionaries; ConfigError if code computes them.

        Raises:
            ConfigError: If only executing the file would tell.
        """
        for item in ast.walk(self.tree):
            if isinstance(item, ast.Dict):
                for name, value in zip(item.keys, item.values, strict=True):
                    if isinstance(name, ast.Constant) and name.value == key:
                        yield from self._read(value)

    def launched_nodes(self) -> list[LaunchedNode]:
        """Return nodes launched from packages at hand; ConfigError if code decides.

        Raises:
            ConfigError: If only executing the file would tell what they get.
        """
        names = [item for item in ast.walk(self.tree) if isinstance(item, ast.Name)]
        loads = {item.id for item in names if isinstance(item.ctx, ast.Load)}
        # What is assigned to a name that nobody reads is not launched.
        unused = [value for name, value in self.values.items() if name not in loads]
        nodes: list[LaunchedNode] = []
        try:
            for item in ast.walk(self.tree):
                if isinstance(item, ast.Call) and item not in unused:
                    nodes += self._nodes(item)
        except RecursionError as error:
            raise ConfigError(f"{self.path}: {error}") from None
        return nodes

    def _nodes(self, call: ast.Call) -> Iterator[LaunchedNode]:
        """Yield what a call starts, a node at hand or those of an included file."""
        match _function(call):
            case "Node":
                package = self._get(call, "package")
                condition = self._get(call, "condition", "true")
                if package in self.packages and str(condition).lower() in _TRUE:
                    executable = self._get(call, "executable")
                    yield package, executable, tuple(self._arguments(call))
            case "PythonLaunchDescriptionSource":
                path = Path(self._text(call.args[0]))
                # Those of other packages are not at hand.
                if path.is_file():
                    yield from SourceFile(path, self.packages).launched_nodes()

    def _arguments(self, call: ast.Call) -> Iterator[str]:
        """Yield a node's arguments: plain, then names, remappings and parameters."""
        for argument in self._get(call, "arguments"):
            yield str(argument)
        yield "--ros-args"
        for keyword, rule in (("name", "__node"), ("namespace", "__ns")):
            text = self._get(call, keyword)
            if text:
                yield from ("-r", f"{rule}:={text}")
        for source, target in self._get(call, "remappings"):
            yield from ("-r", f"{source}:={target}")
        for parameters in self._get(call, "parameters"):
            if isinstance(parameters, dict):
                for name, text in parameters.items():
                    yield from ("-p", f"{name}:={text}")
            else:
                yield from ("--params-file", parameters)
        yield "--"

    def _get(self, call: ast.Call, keyword: str, default: Any = ()) -> Any:
        """Return the value of a call's keyword argument, `default` without one."""
        value = _keyword(call, keyword)
        return default if value is None else self._read(value)

    def _text(self, value: ast.expr | None) -> str:
        """Return the text that an expression stands for; texts of a list are joined."""
        content = self._read(value)
        if isinstance(content, list):
            return "".join(map(str, content))
        return str(content)

    def _parameter(self, value: ast.expr) -> str:
        """Return the YAML of a parameter's value."""
        content = self._read(value)
        # What arguments of the launch stand for is YAML, as it is there.
        if isinstance(content, str) and not isinstance(value, ast.Constant):
            return content
        return json.dumps(content)

    def _read(self, value: ast.expr | None) -> Any:
        """Return an expression's value; ConfigError if only execution would tell.

        Raises:
            ConfigError: If only executing the file would tell.
        """
        match value:
            case ast.Constant() | ast.UnaryOp(ast.USub(), ast.Constant()):
                return ast.literal_eval(value)
            case ast.Name(name) if name in self.values:
                return self._read(self.values[name])
            case ast.List(items) | ast.Tuple(items):
                return [self._read(item) for item in items]
            case ast.Dict(keys, items):
                pairs = zip(keys, items, strict=True)
                return {self._text(key): self._parameter(item) for key, item in pairs}
            case ast.Call():
                return self._read_call(value)
        return self._read_joined(value)

    def _read_joined(self, value: ast.expr | None) -> str:
        """Return the text of an f-string or a sum; ConfigError as `_read`."""
        match value:
            case ast.JoinedStr(items):
                return "".join(map(self._text, items))
            case ast.FormattedValue(item):
                return self._text(item)
            case ast.BinOp(left, ast.Add(), right):
                return self._text(left) + self._text(right)
        line = getattr(value, "lineno", 1)
        text = ast.unparse(value) if value else "**"
        raise ConfigError(
            f"{self.path}, line {line}: cannot read {text} without executing it; name"
            " what to start, DIR:EXECUTABLE or DIR:MODULE:FUNCTION, with its parameters"
            " after --ros-args"
        )

    def _read_call(self, call: ast.Call) -> Any:
        """Return the value of a path, wrapper or launch argument; else ConfigError."""
        name = _function(call)
        arguments = [*call.args, *(keyword.value for keyword in call.keywords)]
        if name in _JOINS:
            parts = [self._read(item) for item in arguments]
            # Substitutions come in a list.
            if isinstance(parts[0], list):
                parts = parts[0]
            return "/".join(map(str, parts))
        if name in _SHARES:
            package = self._text(arguments[0])
            return str(self.packages.get(package, Path("share", package)))
        if name in _WRAPPERS:
            return self._read(arguments[0])
        if name == "LaunchConfiguration":
            default = _keyword(call, "default")
            if default is None:
                default = self.defaults.get(self._text(arguments[0]))
            if default is not None:
                return self._read(default)
        return self._read_joined(call)


def _function(call: ast.Call) -> str:
    """Return the last part of a called function's dotted name."""
    return ast.unparse(call.func).rpartition(".")[2]


def _keyword(call: ast.Call, name: str) -> ast.expr | None:
    """Return the argument of a call by keyword, None without one."""
    for keyword in call.keywords:
        if keyword.arg == name:
            return keyword.value
    return None
