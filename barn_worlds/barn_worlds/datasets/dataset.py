"""Data sets: numbered worlds from the package, a folder or a file."""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from barn_worlds.base.config import read_selection
from barn_worlds.base.errors import WorldError, format_value, note, suggest
from barn_worlds.base.files import package_data
from barn_worlds.formats import dataset_file, map_server, original, single
from barn_worlds.formats.world_yaml import ENDING
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.course import draw_routes, fit_to_robot, scale_to_robot
from barn_worlds.worlds.world import World

# Data set whose worlds are scaled to the size of each robot.
MANEUVERS = "maneuvers"
# Worlds of a data set that stay in memory.
MAX_CACHED_WORLDS = 2000
_MAX_QUOTED_CHARACTERS = 300
# If a folder has files of several kinds, those of the first kind are its worlds.
_FOLDER_KINDS = (
    (ENDING,),
    single.GAZEBO_ENDINGS,
    single.MAP_ENDINGS,
    (".map",),
    (".npy",),
)
# Beginnings of names of hidden files, and of files beside the .npy grids of the original
# data set, which are not worlds.
_COMPANION_FILES = (".", "path_", "cspace_", "metrics_")


@dataclass(frozen=True, eq=False)
class Dataset:
    """Numbered worlds, each read when it is first loaded."""

    name: str
    # Functions that read the worlds, by number.
    readers: Mapping[int, Callable[[], World]]
    # Manifest of a data set in the suite's own format, else empty.
    manifest: Mapping[str, Any] = field(default_factory=dict)
    # Readers of whole maps, if the worlds are routes that the map files name.
    maps: Mapping[int, Callable[[], World]] = field(default_factory=dict)
    _cache: dict[int, World] = field(default_factory=dict, init=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without the loaded worlds."""
        # Other processes read the worlds themselves: that is faster than unpickling.
        return {**self.__dict__, "_cache": {}}

    @property
    def world_numbers(self) -> tuple[int, ...]:
        """Numbers of the worlds, ascending."""
        return tuple(sorted(self.readers))

    def load(self, world_number: int) -> World:
        """Return a world by number, cached; WorldError if missing or unreadable."""
        if world_number not in self.readers:
            raise WorldError(
                f"{self.name}: no world {world_number}; there are {len(self.readers)} "
                f"worlds from {min(self.readers)} to {max(self.readers)}"
            )
        if world_number not in self._cache:
            # Worlds of a large data set would fill the memory.
            if len(self._cache) >= MAX_CACHED_WORLDS:
                self._cache.clear()
            self._cache[world_number] = self.readers[world_number]()
        return self._cache[world_number]

    def for_robot(self, robot: Robot, course: Sequence[float] = ()) -> "Dataset":
        """Return a copy of the data set that fits each world to a robot as it loads.

        Args:
            robot: Its footprint decides which paths fit.
            course: Other start and goal for all worlds (`worlds.course.fit_to_robot`).
        """
        readers = {
            # Not a lambda: data sets are pickled for worker processes.
            world_number: partial(self._load_for_robot, world_number, robot, course)
            for world_number in self.readers
        }
        return replace(self, readers=readers)

    def _load_for_robot(
        self, world_number: int, robot: Robot, course: Sequence[float]
    ) -> World:
        """Return a world scaled to a robot, with a path for it (`fit_to_robot`)."""
        return fit_to_robot(self.load_scaled(world_number, robot), robot, course)

    def load_scaled(self, world_number: int, robot: Robot) -> World:
        """Return a world, scaled to a robot if a maneuver, or shipped and too narrow.

        Every maneuver has the robot's size. A world of another shipped data set is
        scaled up, with a note, only if it is too narrow for the robot.

        Raises:
            WorldError: As `load`.
        """
        world = self.load(world_number)
        if self.name == MANEUVERS:
            return world.resize(robot.reach_m / STANDARD_ROBOT.reach_m)
        if self.name not in dataset_files() or self.manifest.get("robot"):
            return world
        scaled = scale_to_robot(world, robot)
        if scaled is not world:
            note(
                f"{self.name}: scaled to cells of {scaled.resolution_m:g} m, because "
                f"robot {robot.name} is wider than its passages"
            )
        return scaled

    def split_into_routes(
        self,
        robot: Robot,
        courses: Sequence[Sequence[float]] = (),
        count: int = 0,
        seed: int = 0,
    ) -> dict[int, World]:
        """Return a world for each course and each drawn route in each world, from 0.

        The numbers follow the order of worlds, then routes. Routes that map files name
        are left out.

        Args:
            robot: Robot that drives.
            courses: Start and goal of each route, as numbers for `parse_course`.
            count: Number of routes to draw in each world, in addition to `courses`.
            seed: Seed of the draw.

        Raises:
            WorldError: If a course cannot be driven, or a world has too few routes.
        """
        maps = replace(self, readers=self.maps or self.readers)
        routes: list[World] = []
        for world in map(maps.load, maps.world_numbers):
            world_routes = [fit_to_robot(world, robot, course) for course in courses]
            if count:
                world_routes += draw_routes(world, robot, count, seed)
            if len(world_routes) > 1:
                world_routes = [
                    replace(route, name=f"{world.name} route {number}")
                    for number, route in enumerate(world_routes)
                ]
            routes += world_routes
        return dict(enumerate(routes))

    def require_fit(self, robot: Robot, world_numbers: Iterable[int]) -> None:
        """Raise WorldError if a robot is too large for worlds made for another one.

        Data sets whose manifest names no robot, such as barn300, pass: they are scaled.

        Args:
            robot: Robot to compare with the one that the manifest names.
            world_numbers: Numbers of the worlds that it would drive in.
        """
        intended_robot = self.manifest.get("robot")
        if not intended_robot:
            return

        for world in map(self.load, world_numbers):
            planned_cells = world.footprint_cells
            needed_cells = robot.footprint_cells(world.resolution_m)
            if needed_cells > planned_cells:
                raise WorldError(
                    f"{self.name} is made for robot {intended_robot}, with paths for "
                    f"{planned_cells} x {planned_cells} cells of "
                    f"{world.resolution_m:g} m: "
                    f"robot {robot.name} takes {needed_cells} x {needed_cells}; use a "
                    f"robot that fits, such as {intended_robot}, or generate worlds: "
                    "barn worlds generate FILE.npz --robot ROBOT"
                )

    @cached_property
    def checksum(self) -> str:
        """SHA-256 (hex) of all worlds and their numbers; computing it loads all."""
        lines = (
            f"{world_number} {self.load(world_number).checksum}\n"
            for world_number in self.world_numbers
        )
        return hashlib.sha256("".join(lines).encode()).hexdigest()


def dataset_files() -> dict[str, Path]:
    """Return the .npz files of the shipped data sets, by name."""
    files = package_data("barn_worlds").glob("*.npz")
    return {file.stem: file for file in sorted(files)}


def open_dataset(source: str | Path, robot: Robot = STANDARD_ROBOT) -> Dataset:
    """Open a shipped data set by name, else that at a path, lazily; WorldError if none.

    A world has the number in its file's name. If a number is missing or not unique,
    files are numbered from 0 in order of their names.

    Args:
        source: The name of a shipped data set (barn300), a data set file (.npz), a
            folder in the original layout, a folder of Gazebo worlds (.world, .sdf,
            gzipped or not), of the suite's YAML (.world.yaml), of .npy grids, of
            map_server maps (.yaml) or of MovingAI maps (.map), or one such file. A
            folder may also hold one data set file.
        robot: Robot whose footprint is used to plan paths if the source has neither
            paths nor a footprint.

    Raises:
        WorldError: If the source is no data set or cannot be read.
    """
    if not isinstance(source, (str, Path)):
        raise WorldError(f"data set must be a name or path, got {format_value(source)}")
    # A shipped name wins over a file of the same name.
    shipped_file = dataset_files().get(str(source))
    if shipped_file is not None:
        return _open_file(shipped_file)

    path = Path(source)
    try:
        if path.is_dir():
            dataset = _open_folder(path, robot)
        elif path.suffix == ".npz" and path.exists():
            dataset = _open_file(path)
        elif path.exists():
            single.require_ending(path)
            dataset = _open_worlds(path.name, [path], robot)
        else:
            raise WorldError(
                f"{str(source)[:_MAX_QUOTED_CHARACTERS]}: no such file, folder or data "
                f"set{suggest(str(source), dataset_files())}"
            )
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise WorldError(f"{str(source)!r:.200}: cannot be read: {reason}") from None

    if not dataset.readers:
        raise WorldError(
            f"{source}: contains no worlds; world files end in "
            f"{', '.join(single.ENDINGS)} or .npz"
        )
    if dataset.name in dataset_files():
        # Its worlds may differ from the suite's.
        return replace(dataset, name=f"own_{dataset.name}")
    return dataset


def _open_folder(path: Path, robot: Robot) -> Dataset:
    """Return the data set of a folder in any layout; its worlds are read later."""
    name = path.resolve().name
    if original.is_original_folder(path):
        readers = {
            world_number: partial(original.read_world, path, world_number, robot)
            for world_number in original.find_world_numbers(path)
        }
        return Dataset(name, readers)

    files = sorted(file for file in path.iterdir() if file.is_file())
    dataset_file_paths = [file for file in files if file.suffix == ".npz"]
    if len(dataset_file_paths) == 1:
        return _open_file(dataset_file_paths[0])

    candidates = [file for file in files if not file.name.startswith(_COMPANION_FILES)]
    world_files: list[Path] = []
    # A folder of Gazebo worlds may also have maps and grids of the same worlds.
    for endings in _FOLDER_KINDS:
        world_files = [file for file in candidates if single.ending(file) in endings]
        if world_files and endings == single.MAP_ENDINGS:
            world_files = map_server.select_maps(world_files)
        if world_files:
            break

    return _open_worlds(name, world_files, robot)


def _open_worlds(name: str, files: Sequence[Path], robot: Robot) -> Dataset:
    """Return a data set, a world per route if map files name any, else per file."""
    numbers = [number for number in map(single.number_in, files) if number is not None]
    if len(set(numbers)) < len(files):
        numbers = list(range(len(files)))
    readers: dict[int, Callable[[], World]] = {}
    routes: list[Callable[[], World]] = []
    has_routes = False
    for number, file in zip(numbers, files, strict=True):
        reader = readers[number] = partial(single.read_world, file, robot)
        names = []
        if single.ending(file) in single.MAP_ENDINGS:
            names = map_server.read_route_names(file)
        has_routes |= bool(names)
        routes += [partial(reader, route) for route in names] or [reader]
    if has_routes:
        return Dataset(name, dict(enumerate(routes)), maps=readers)
    return Dataset(name, readers)


def _open_file(path: Path) -> Dataset:
    """Return the data set in a .npz file of the suite; its worlds are built later."""
    content = dataset_file.read_dataset_file(path)
    readers = {
        world_number: partial(content.world, position)
        for position, world_number in enumerate(content.indices)
    }
    return Dataset(str(content.manifest["name"]), readers, manifest=content.manifest)


LONGEST_SPEC = 10_000
_PART = re.compile(r"(\d{1,9})(?:-(\d{1,9})|:(\d{1,9})(?::(\d{1,9}))?)?")


def select_worlds(
    spec: str | int | Iterable[int], world_numbers: Iterable[int]
) -> list[int]:
    """Return the numbers of "60,0-9" or "all", in this order; WorldError for a bad one.

    Each number occurs once.

    Args:
        spec: "7" must exist. The ranges "0-49" (both ends included) and "0:300:6" (like
            a Python range, end excluded) select the numbers that exist, at least one;
            if the data set's numbers have no gaps, all must exist. "1,4,7-9" is a list,
            "all" is every world. Plain numbers are allowed too (`read_selection`).
        world_numbers: Numbers to select from.

    Raises:
        WorldError: If the selection has another form or names a missing world.
    """
    numbers = sorted(set(world_numbers))
    spec = read_selection(spec, WorldError)
    if len(spec) > LONGEST_SPEC:
        raise WorldError(
            f"a selection of worlds must have at most {LONGEST_SPEC} characters, "
            f"got {len(spec)}"
        )
    if not numbers:
        raise WorldError("there are no worlds to select from")

    # A dict keeps the order of the selection and has each number once.
    selection: dict[int, None] = {}
    try:
        for part in spec.split(","):
            selection.update(dict.fromkeys(_select_part(part.strip(), numbers)))
    except WorldError as error:
        raise WorldError(f"worlds {spec!r:.80}: {error}") from None
    return list(selection)


def _select_part(part: str, numbers: Sequence[int]) -> Iterator[int]:
    """Yield the numbers that one part of a selection has; WorldError if not allowed.

    A range needs one existing number; among numbers without gaps, all must exist.
    """
    if part == "all":
        yield from numbers
        return

    match = _PART.fullmatch(part)
    if match is None:
        raise WorldError(
            f"{part!r:.40} must be a number, first-last, start:stop, start:stop:step, "
            "several of these joined by commas, or all"
        )
    first, last, stop, step = match.groups()
    if step and not int(step):
        raise WorldError(f"the step in {part!r} must be at least 1")

    end = int(stop) if stop else int(last or first) + 1
    selection = range(int(first), end, int(step or 1))
    existing = [number for number in numbers if number in selection]
    is_gapless = numbers[-1] - numbers[0] == len(numbers) - 1
    if not existing or (is_gapless and len(existing) < len(selection)):
        missing = part
        if existing:
            # The range may be huge: it is searched only up to the first missing number.
            outside = (
                number
                for number in selection
                if not numbers[0] <= number <= numbers[-1]
            )
            missing = f"{next(outside)} of {part}"
        raise WorldError(
            f"no world {missing} among the {len(numbers)} "
            f"from {numbers[0]} to {numbers[-1]}"
        )
    yield from existing
