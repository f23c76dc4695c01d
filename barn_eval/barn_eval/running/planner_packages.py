"""Planners in ROS packages that nobody built: what colcon would start, from the source.

Files of a package are parsed and never executed. A planner command "package:TEXT" has
the text of `--planner-package`: DIR, DIR:EXECUTABLE, DIR:MODULE:FUNCTION or
FILE.py[:FUNCTION], with arguments behind.
"""

import ast
import configparser
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from barn_worlds.base.errors import ConfigError, convert_os_errors, suggest
from barn_worlds.base.files import read_bytes

PREFIX = "package:"
"""Beginning of a planner command that names a package."""

_MANIFEST = "package.xml"
_LARGEST_BYTES = 1 << 20
# Folders below that of a user in which packages are looked for: src/PACKAGE, mostly.
_DEPTH = 4
# What a build leaves, where the same packages lie again.
_BUILD_FOLDERS = frozenset(["build", "install", "log"])
_SCRIPT = re.compile(r"\s*'?([\w.{}-]+)\s*=\s*([\w.{}]+:\w+)")
_PROGRAMS = re.compile(r"install\s*\(\s*PROGRAMS\s([^)]*?)\sDESTINATION", re.DOTALL)
_COMPILED = re.compile(r"add_(?:executable|library)\s*\(\s*([\w${}.-]+)")
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

    # "MODULE:FUNCTION", or a script relative to the folder.
    entry: str

    @property
    def command(self) -> tuple[str, ...]:
        """Words that start it, without arguments of its own."""
        module, colon, function = self.entry.partition(":")
        if not colon:
            return (sys.executable, str((self.folder / self.entry).resolve()))
        return (sys.executable, "-c", _START.format(module, function, self.name))

    @property
    def is_packaged(self) -> bool:
        """Whether the folder is that of a package, and not of a single file."""
        return (self.folder / _MANIFEST).is_file()

    @property
    def packages(self) -> list[Path]:
        """Folders of its package and of those beside it, which it may import."""
        folder = self.folder.resolve()
        neighbors = sorted(folder.parent.glob(f"*/{_MANIFEST}"))
        return list(dict.fromkeys([folder, *(path.parent for path in neighbors)]))

    @property
    def import_path(self) -> list[Path]:
        """Folders that its modules are imported from."""
        return [
            path for package in self.packages for path in (package, package / "src")
        ]

    def source(self) -> Path | None:
        """Return the file that the entry is in, None if there is none."""
        module, colon, _ = self.entry.partition(":")
        if not colon:
            return self.folder / self.entry
        return find_module(module, self.import_path)

    def make_prefix(self, prefix: Path, inherited: Mapping[str, str]) -> dict[str, str]:
        """Link the packages into a prefix of ROS, and return variables that name it.

        Args:
            prefix: Folder to make.
            inherited: Environment variables, whose paths come last.

        Raises:
            ConfigError: If the prefix cannot be written.
        """
        index = prefix / "share" / "ament_index" / "resource_index" / "packages"
        with convert_os_errors(ConfigError, prefix):
            index.mkdir(parents=True, exist_ok=True)
            for package in self.packages:
                name = _package_name(package)
                (index / name).touch()
                link = prefix / "share" / name
                link.unlink(missing_ok=True)
                link.symlink_to(package, target_is_directory=True)
        variables = {}
        for key, folders in (
            ("PYTHONPATH", self.import_path),
            ("AMENT_PREFIX_PATH", [prefix.resolve()]),
        ):
            texts = [*map(str, folders), inherited.get(key, "")]
            variables[key] = ":".join(filter(None, texts))
        return variables


def find_executable(text: str) -> Executable:
    """Return the executable that DIR[:EXECUTABLE] or FILE.py[:FUNCTION] names.

    Raises:
        ConfigError: If there is no such package or executable, or several.
    """
    path_text, _, name = text.partition(":")
    path = Path(path_text)
    subject = f"planner package {text!r}"
    if path.suffix == ".py" and path.is_file():
        return Executable(path.stem, path.parent, f"{path.stem}:{name or 'main'}")
    if not path.is_dir():
        raise ConfigError(f"{subject}: no folder or Python file {path}")

    packages = [file.parent for file in _walk(path, _DEPTH) if file.name == _MANIFEST]
    if not packages:
        raise ConfigError(f"{subject}: no package (package.xml) in {path}")
    if ":" in name:
        return Executable(name.partition(":")[0], packages[0], name)

    executables = []
    for package in packages:
        executables += _read_executables(package)
    if not executables:
        raise ConfigError(f"{subject}: {_explain_none(packages)}")
    matching = [item for item in executables if name in ("", item.name)]
    if len(matching) == 1:
        return matching[0]

    problem = "name one of its executables"
    if not matching:
        names = [item.name for item in executables]
        problem = f"no executable {name!r}{suggest(name, names)}; {problem}"
    choices = ", ".join(
        f"{item.folder}:{item.name}" for item in matching or executables
    )
    raise ConfigError(f"{subject}: {problem}: {choices}")


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


def _explain_none(packages: list[Path]) -> str:
    """Return why no executable of packages can be started, with what to do instead."""
    for package in packages:
        for name in _COMPILED.findall(_read(package / "CMakeLists.txt")):
            return (
                f"{name} of {package} is compiled; build it with colcon, and start it by"
                f' --planner-command "ros2 run {_package_name(package)} {name}"'
            )
    return (
        "no console_scripts in setup.py or setup.cfg, no install(PROGRAMS) in"
        " CMakeLists.txt; name the function to start: DIR:MODULE:FUNCTION"
    )


def _package_name(package: Path) -> str:
    """Return the name that package.xml gives, else the folder's."""
    match = re.search(r"<name>\s*([\w-]+)\s*</name>", _read(package / _MANIFEST))
    return match[1] if match else package.name


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    """Yield files below a folder to a depth, but hidden ones and those of a build."""
    for path in sorted(folder.iterdir()):
        if path.is_file():
            yield path
        elif depth and path.name[0] != "." and path.name not in _BUILD_FOLDERS:
            yield from _walk(path, depth - 1)


def _read(path: Path) -> str:
    """Return the text of a file, empty if there is none."""
    if not path.is_file():
        return ""
    return read_bytes(path, _LARGEST_BYTES).decode("utf-8", "replace")


def _read_executables(package: Path) -> list[Executable]:
    """Return the Python executables that a package installs."""
    executables = []
    for line in (*_setup_py_scripts(package), *_setup_cfg_scripts(package)):
        match = _SCRIPT.match(line)
        if match:
            executables.append(Executable(match[1], package, match[2]))
    for programs in _PROGRAMS.findall(_read(package / "CMakeLists.txt")):
        for script in programs.split():
            if script.endswith(".py"):
                executables.append(Executable(Path(script).name, package, script))
    return executables


def _setup_cfg_scripts(package: Path) -> list[str]:
    """Return the lines of console_scripts in setup.cfg."""
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(_read(package / "setup.cfg"))
    except configparser.Error as error:
        raise ConfigError(f"{package / 'setup.cfg'}: {error}") from None
    scripts = parser.get("options.entry_points", "console_scripts", fallback="")
    return scripts.splitlines()


def _setup_py_scripts(package: Path) -> list[str]:
    """Return console_scripts of setup.py, texts and f-strings of texts.

    Raises:
        ConfigError: If the file is no Python, or computes them in another way.
    """
    path = package / "setup.py"
    try:
        tree = ast.parse(_read(path))
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from None

    # Names of texts, such as package_name, which f-strings refer to.
    texts: dict[str, str] = {}
    scripts: list[str] = []
    for node in ast.walk(tree):
        match node:
            case ast.Assign([ast.Name(name)], ast.Constant(str(text))):
                texts[name] = text
            case ast.Dict(keys, values):
                for key, value in zip(keys, values, strict=True):
                    match key, value:
                        case ast.Constant("console_scripts"), ast.List(entries):
                            # Unparsed, they are without comments and in single quotes.
                            lines = [ast.unparse(entry) for entry in entries]
                            scripts += [line.removeprefix("f") for line in lines]
    for script in scripts:
        fields = set(re.findall(r"{(\w+)}", script))
        if not _SCRIPT.match(script) or not fields <= texts.keys():
            raise ConfigError(
                f"{path}: cannot read {script} without executing it; name the function"
                " to start: DIR:MODULE:FUNCTION"
            )
    return [script.format_map(texts) for script in scripts]
