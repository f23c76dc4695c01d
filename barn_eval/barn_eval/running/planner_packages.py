"""Planners in ROS packages that nobody built: what colcon would start, from the source.

Files of a package are parsed and never executed. A planner command "package:TEXT" has
the text of `--planner-package`: DIR, DIR:EXECUTABLE, DIR:FILE.launch.py,
DIR:MODULE:FUNCTION or FILE.py[:FUNCTION], followed by arguments.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from barn_eval.running import start_nodes
from barn_eval.running.source_files import LAUNCHES, SourceFile
from barn_worlds.base.errors import ConfigError, convert_os_errors, suggest
from barn_worlds.base.files import read_bytes

PREFIX = "package:"
"""Beginning of a planner command that names a package."""

_MANIFEST = "package.xml"
_SETUP = "setup.py"
_CMAKE = "CMakeLists.txt"
_BUILDS = (_SETUP, _CMAKE)
# Part of the stand-ins, which a workspace of a full ROS need not have.
_TYPE_BUILDER = "barn_ros_stand_ins.missing_types"
_LARGEST_BYTES = 1 << 20
# Depth to which packages are sought below the user's folder: mostly src/PACKAGE.
_DEPTH = 4
# Hidden folders, and what a build leaves, with copies of the same packages.
_SKIPPED = re.compile(r"\..*|build|install|log")
_SCRIPT = re.compile(r"\s*([\w.-]+)\s*=\s*([\w.]+:\w+)\s*")
_PROGRAMS = re.compile(r"install\s*\(\s*PROGRAMS\s([^)]*?)\sDESTINATION", re.DOTALL)
_NAME = re.compile(r"<name>\s*([\w-]+)\s*</name>")
_PROJECT = re.compile(r"project\s*\(\s*([\w.-]+)", re.IGNORECASE)
_VARIABLE = re.compile(r'set\s*\(\s*(\w+)\s+"?([\w.-]+)"?\s*\)', re.IGNORECASE)
_COMPILED = re.compile(r"add_executable\s*\(\s*([\w${}.-]+)")
_NO_EXECUTABLES = (
    "no console_scripts in setup.py or setup.cfg, no install(PROGRAMS) in"
    " CMakeLists.txt; name the function to start: DIR:MODULE:FUNCTION"
)
# Starts an entry as an installed script does, without the working directory in the
# import path, where the folders of a source tree would hide installed packages.
_START = (
    "import sys; sys.path.pop(0); from {} import {} as main;"
    " sys.argv[0] = {!r}; sys.exit(main())"
)


@dataclass(frozen=True)
class Executable:
    """An executable of a package that is started from its source."""

    name: str

    # Folder of the package, or of a file that is no part of any.
    folder: Path

    # "MODULE:FUNCTION", or a script or launch file relative to the folder.
    entry: str

    # Of a launch file: what it starts, with arguments.
    launched: tuple[tuple["Executable", tuple[str, ...]], ...] = ()

    @property
    def command(self) -> tuple[str, ...]:
        """Words that start the executable, without arguments of its own."""
        if self.launched:
            commands = [
                [*node.command, *arguments] for node, arguments in self.launched
            ]
            return (sys.executable, start_nodes.__file__, json.dumps(commands))
        module, colon, function = self.entry.partition(":")
        if not colon:
            return (sys.executable, str((self.folder / self.entry).resolve()))
        return (sys.executable, "-c", _START.format(module, function, self.name))

    @property
    def is_packaged(self) -> bool:
        """Whether the folder belongs to a package and not to a single file."""
        return any((self.folder / name).is_file() for name in (_MANIFEST, *_BUILDS))

    @property
    def packages(self) -> list[Path]:
        """Folders of its package and of those beside it, which it may import."""
        packages = []
        for folder in (self.folder, *(node.folder for node, _ in self.launched)):
            packages.append(folder.resolve())
            neighbors = sorted(folder.resolve().parent.glob(f"*/{_MANIFEST}"))
            packages += [path.parent for path in neighbors]
        return list(dict.fromkeys(packages))

    @property
    def import_path(self) -> list[Path]:
        """Folders from which its modules are imported."""
        folders = [
            path for package in self.packages for path in (package, package / "src")
        ]
        # Scripts of a package are installed side by side, and import each other.
        if ":" not in self.entry and not self.launched:
            folders.insert(0, self.sources()[0].resolve().parent)
        return folders

    def sources(self) -> list[Path]:
        """Return the file that the entry is in, or those of all that is launched."""
        if self.launched:
            return [path for node, _ in self.launched for path in node.sources()]
        module, colon, _ = self.entry.partition(":")
        if not colon:
            return [self.folder / self.entry]
        missing = self.folder.joinpath(*module.split(".")).with_suffix(".py")
        return [find_module(module, self.import_path) or missing]

    def make_prefix(self, prefix: Path, inherited: Mapping[str, str]) -> dict[str, str]:
        """Link packages into a ROS prefix, build types; return variables that lead there.

        Args:
            prefix: Folder to make.
            inherited: Environment variables, whose paths come last.

        Raises:
            ConfigError: If the prefix cannot be written.
        """
        prefix = prefix.absolute()
        types = prefix / "types"
        index = prefix / "share" / "ament_index" / "resource_index" / "packages"
        with convert_os_errors(ConfigError, prefix):
            index.mkdir(parents=True, exist_ok=True)
            for package in self.packages:
                name = _package_name(package)
                (index / name).touch()
                link = prefix / "share" / name
                link.unlink(missing_ok=True)
                link.symlink_to(package, target_is_directory=True)
            # If that fails, the planner says which modules are missing, and the log why.
            words = [sys.executable, "-m", _TYPE_BUILDER, str(types), f"{prefix}/share"]
            words += map(str, self.sources())
            with types.with_suffix(".log").open("ab") as log:
                subprocess.run(words, stdout=log, stderr=log, check=False)  # noqa: S603
        variables = {}
        for key, folders in (
            ("PYTHONPATH", [*self.import_path, types]),
            ("LD_LIBRARY_PATH", [types]),
            ("AMENT_PREFIX_PATH", [prefix]),
        ):
            texts = [*map(str, folders), inherited.get(key, "")]
            variables[key] = ":".join(filter(None, texts))
        return variables


def find_packaged(words: Sequence[str]) -> Executable | None:
    """Return what a command starts from a package, or None; ConfigError if missing.

    Args:
        words: Words of the command.

    Raises:
        ConfigError: As for `find_executable`.
    """
    if not words[0].startswith(PREFIX):
        return None
    executable = find_executable(words[0].removeprefix(PREFIX))
    if executable.launched and ":=" in "".join(words[1:2]):
        raise ConfigError(
            f"planner package {words[0].removeprefix(PREFIX)!r}: arguments of launch files are not supported, got"
            f" {words[1]!r}; set parameters of its nodes after --ros-args -p"
        )
    return executable


def find_executable(text: str) -> Executable:
    """Return the executable that --planner-package names; ConfigError unless unique.

    Raises:
        ConfigError: If there is no such package or executable, or several, or a launch
            file that starts none.
    """
    path_text, _, name = text.partition(":")
    path = Path(path_text)
    subject = f"planner package {text!r:.200}"
    with convert_os_errors(ConfigError, subject):
        is_file = path.is_file()
    if is_file and path.suffix == ".py":
        text = _read(path)
        if LAUNCHES not in text:
            # Scripts start by themselves; other files have a function to call.
            is_script = not name and ("__name__" in text or "def main(" not in text)
            entry = path.name if is_script else f"{path.stem}:{name or 'main'}"
            return Executable(path.stem, path.parent, entry)
        # It lies in the folder launch of its package, and may start nodes of others.
        launch_file = Executable(path.name, path.absolute().parents[1], str(path))
        return _read_launched(path, launch_file.packages)
    if not path.is_dir():
        raise ConfigError(f"{subject}: no folder or Python file {path}")

    files = list(_walk(path, _DEPTH))
    packages = [file.parent for file in files if file.name == _MANIFEST]
    # Some have no manifest.
    packages = packages or [file.parent for file in files if file.name in _BUILDS]
    if not packages:
        commanding = [
            str(file)
            for file in files
            if file.suffix == ".py" and "Twist" in _read(file)
        ]
        hint = f": {', '.join(commanding)}" if commanding else ""
        raise ConfigError(
            f"{subject}: no package (package.xml) in {path}; give a single file as"
            f" FILE.py or FILE.py:FUNCTION{hint}"
        )
    if ":" in name:
        return Executable(name.partition(":")[0], packages[0], name)

    try:
        return _choose(name, files, packages)
    except ConfigError as error:
        raise ConfigError(f"{subject}: {error}") from None


def _choose(name: str, files: Sequence[Path], packages: Sequence[Path]) -> Executable:
    """Return the executable or launch file of a name, or the only one; or ConfigError.

    Args:
        name: Its name; empty for the only executable.
        files: Files of the packages.
        packages: Folders of the packages.

    Raises:
        ConfigError: If there is none, or are several.
    """
    executables = []
    for package in packages:
        executables += _read_executables(package)
    launch_files = [
        file for file in files if file.suffix == ".py" and LAUNCHES in _read(file)
    ]
    named_files = [file for file in launch_files if name and file.match(name)]
    if len(named_files) == 1:
        return _read_launched(named_files[0], packages)
    compiled = _explain_compiled(packages)
    # Built with ROS 1's catkin.
    catkin = "<buildtool_depend>catkin<"
    if not executables and all(catkin in _read(item / _MANIFEST) for item in packages):
        raise ConfigError(
            "the package is for ROS 1; see docs/tutorials/other_stacks.md"
        )
    if not executables:
        raise ConfigError(compiled or _NO_EXECUTABLES)
    matching = [item for item in executables if name in ("", item.name)]
    # Beside a compiled planner there may be a helper in Python.
    if len(matching) == 1 and (name or not compiled):
        (source,) = matching[0].sources()
        stray = [file for file in files if file.name == source.name]
        if stray and not source.is_file():
            raise ConfigError(f"{source} is missing; instead start {stray[0]}")
        return matching[0]

    problem = "name one of its executables or launch files"
    # Those that send commands come first.
    executables.sort(key=lambda item: "Twist" not in _read(item.sources()[0]))
    names = [item.name for item in executables]
    names += [file.name for file in launch_files]
    if named_files or (name and matching):
        names = [f"{item.folder}:{name}" for item in matching]
        names += map(str, named_files)
    elif name:
        problem = f"no executable {name!r}{suggest(name, names)}; {problem}"
    choices = ", ".join(dict.fromkeys(names))
    raise ConfigError(
        "; ".join(filter(None, [f"{problem}, as DIR:NAME: {choices}", compiled]))
    )


def _read_launched(path: Path, packages: Sequence[Path]) -> Executable:
    """Return a launch file as one executable; ConfigError if a node has no source."""
    # Of equal names, the first counts: the file's own package.
    folders = {_package_name(package): package for package in reversed(packages)}
    launched = []
    for package, name, arguments in SourceFile(path, folders).launched_nodes():
        by_name = {item.name: item for item in _read_executables(folders[package])}
        executable = by_name.get(name)
        if executable is None:
            raise ConfigError(
                f"{path}: package {package!r} has no Python executable {name!r}; build it"
                " with colcon and start it by --planner-command"
                f' "ros2 launch {package} {path.name}"'
            )
        launched.append((executable, arguments))
    if not launched:
        raise ConfigError(
            f"{path}: starts no node of its package or of a package beside it"
        )
    folder = launched[0][0].folder
    return Executable(path.name, folder, str(path), tuple(launched))


def find_module(name: str, folders: Sequence[Path]) -> Path | None:
    """Return the file of a module by dotted name, None if no folder has it.

    Args:
        name: Dotted name of a module or package.
        folders: Where to look, in order.
    """
    for folder in folders:
        stem = folder.joinpath(*name.split("."))
        for path in (stem.with_name(f"{stem.name}.py"), stem / "__init__.py"):
            if path.is_file():
                return path
    return None


def _explain_compiled(packages: Sequence[Path]) -> str:
    """Return which program of packages is compiled and how to start it, or ""."""
    for package in packages:
        text = _read_cmake(package)
        for name in _COMPILED.findall(text):
            return (
                f"{name} of {package} is compiled; build it with colcon, and start it by"
                f' --planner-command "ros2 run {_package_name(package)} {name}"'
            )
        if "add_library(" in text:
            return (
                f"{package} is a compiled plugin that another program loads; build it"
                " with colcon and see docs/tutorials/nav2.md"
            )
    return ""


def _package_name(package: Path) -> str:
    """Return a package's name in package.xml or CMakeLists.txt, else the folder's."""
    match = _NAME.search(_read(package / _MANIFEST))
    match = match or _PROJECT.search(_read(package / _CMAKE))
    return match[1] if match else package.name


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    """Yield files below a folder to a depth, except in hidden or build folders."""
    for path in sorted(folder.iterdir()):
        if path.is_file():
            yield path
        elif depth and path.is_dir() and not _SKIPPED.fullmatch(path.name):
            yield from _walk(path, depth - 1)


def _read(path: Path) -> str:
    """Return the text of a file, empty if there is none."""
    if not path.is_file():
        return ""
    return read_bytes(path, _LARGEST_BYTES).decode("utf-8", "replace")


def _read_cmake(package: Path) -> str:
    """Return a package's CMake file without comments, its plain variables filled in."""
    text = re.sub(r"#.*", "", _read(package / _CMAKE))
    variables = {
        "PROJECT_NAME": _package_name(package),
        **dict(_VARIABLE.findall(text)),
    }
    for name, value in variables.items():
        text = text.replace(f"${{{name}}}", value)
    return text


def _read_executables(package: Path) -> list[Executable]:
    """Return the Python executables that a package installs."""
    executables = []
    lines = _read(package / "setup.cfg").splitlines()
    setup = package / _SETUP
    if setup.is_file():
        lines += SourceFile(setup).entries("console_scripts")
    for line in lines:
        match = _SCRIPT.fullmatch(line)
        if match:
            executables.append(Executable(match[1], package, match[2]))
    for programs in _PROGRAMS.findall(_read_cmake(package)):
        for script in programs.split():
            if script.endswith(".py"):
                executables.append(Executable(Path(script).name, package, script))
    return executables
