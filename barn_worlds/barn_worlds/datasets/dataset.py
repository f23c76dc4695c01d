"""Data sets: numbered worlds from the package itself, a folder or a file, all used the same way."""

import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import resources
from pathlib import Path
from typing import Any

from barn_worlds.base.errors import WorldError, suggest
from barn_worlds.formats import original, own, single
from barn_worlds.formats.world_yaml import ENDING
from barn_worlds.robots.files import STANDARD
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.course import fit_to_robot
from barn_worlds.worlds.world import World

_MOST_KEPT = 1000
_LONGEST_SHOWN = 300


@dataclass(frozen=True, eq=False)
class Dataset:
    """Numbered worlds, read when asked for.

    readers: for each number, the function that reads the world. manifest: that of a data set in the suite's own format,
    else empty. Worlds that have been read are kept.
    """

    name: str
    readers: Mapping[int, Callable[[], World]]
    manifest: Mapping[str, Any] = field(default_factory=dict)
    _kept: dict[int, World] = field(default_factory=dict, init=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return {
            **self.__dict__,
            "_kept": {},
        }  # other processes read the worlds themselves

    @property
    def world_numbers(self) -> tuple[int, ...]:
        """Numbers of the worlds, ascending."""
        return tuple(sorted(self.readers))

    def load(self, index: int) -> World:
        """Return a world; WorldError if there is none of that number or it cannot be read."""
        if index not in self.readers:
            known = f"{len(self.readers)} worlds from {min(self.readers)} to {max(self.readers)}"
            raise WorldError(f"{self.name}: no world {index}; there are {known}")
        if index not in self._kept:
            if len(self._kept) >= _MOST_KEPT:
                self._kept.clear()
            self._kept[index] = self.readers[index]()
        return self._kept[index]

    def for_robot(self, robot: Robot, course: Sequence[float] = ()) -> "Dataset":
        """Return the data set with its worlds as a robot drives them (`worlds.course.fit_to_robot`)."""
        return replace(
            self,
            readers={
                index: partial(self._for_robot, index, robot, course)
                for index in self.readers
            },
        )

    def _for_robot(self, index: int, robot: Robot, course: Sequence[float]) -> World:
        return fit_to_robot(self.load(index), robot, course)

    def require_fit(self, robot: Robot, indices: Iterable[int]) -> None:
        """Raise WorldError if the data set was generated for another robot, and this one takes more cells of a world.

        Data sets that name no robot in their manifest, such as barn300, are for any.
        """
        made_for = self.manifest.get("robot") or robot.name
        for world in map(self.load, () if made_for == robot.name else indices):
            side_m, own, cells = (
                world.resolution_m,
                world.footprint_cells,
                robot.footprint_cells(world.resolution_m),
            )
            if cells > own:
                made = f"{self.name} is made for robot {made_for}, with ways for {own} x {own} cells of {side_m:g} m"
                takes = f"robot {robot.name} takes {cells} x {cells}"
                raise WorldError(
                    f"{made}: {takes}; name one that fits, such as {made_for}"
                )

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of all worlds and their numbers; reads them all."""
        lines = (
            f"{index} {self.load(index).checksum}\n" for index in self.world_numbers
        )
        return hashlib.sha256("".join(lines).encode()).hexdigest()


def dataset_files() -> dict[str, Path]:
    """Return the files of the data sets that come with the package, by name."""
    folder = Path(str(resources.files("barn_worlds"))) / "data"
    return {file.stem: file for file in sorted(folder.glob("*.npz"))}


def open_dataset(source: str | Path, robot: Robot = STANDARD) -> Dataset:
    """Return the data set that `source` names; WorldError in one line if it is none.

    source: the name of a shipped data set (barn300), a data set file (.npz), a folder in the original layout, a folder
    of Gazebo worlds (.world, .sdf, gzipped or not), the suite's YAML (.world.yaml), .npy grids or map_server maps
    (.yaml), or one such file. A world has the number in its file's name. If a number is missing or not unique, files
    are numbered from 0 in order of name.
    robot: its footprint is used to plan paths if the source has neither paths nor a footprint.
    """
    if str(source) in dataset_files():
        return _own(dataset_files()[str(source)])
    path = Path(source)
    try:
        if path.is_dir():
            found = _folder(path, robot)
        elif path.suffix == ".npz" and path.exists():
            found = _own(path)
        elif path.exists():
            single.check_ending(path)
            found = Dataset(
                path.name,
                {single.number_in(path) or 0: partial(single.read_world, path, robot)},
            )
        else:
            where, hint = (
                str(source)[:_LONGEST_SHOWN],
                suggest(str(source), dataset_files()),
            )
            raise WorldError(f"{where}: no such file, folder or data set{hint}")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise WorldError(f"{str(source)!r:.200}: cannot be read: {why}") from None
    if not found.readers:
        raise WorldError(
            f"{source}: has no worlds; their files end in {', '.join(single.ENDINGS)} or .npz"
        )
    return found


def _folder(path: Path, robot: Robot) -> Dataset:
    name = path.resolve().name
    if original.is_original_folder(path):
        numbers = original.indices(path)
        return Dataset(
            name,
            {
                index: partial(original.read_world, path, index, robot)
                for index in numbers
            },
        )
    files = sorted(file for file in path.iterdir() if file.is_file())
    packed = [file for file in files if file.suffix == ".npz"]
    if len(packed) == 1:
        return _own(packed[0])
    kinds = ((ENDING,), single.GAZEBO_ENDINGS, single.MAP_ENDINGS, (".map",), (".npy",))
    by_kind = (
        [file for file in files if single.ending(file) in kind] for kind in kinds
    )
    beside = ("path_", "cspace_", "metrics_")
    worlds = [
        file
        for file in next(filter(None, by_kind), [])
        if not file.name.startswith(beside)
    ]
    numbers_there = [single.number_in(file) for file in worlds]
    unique = None not in numbers_there and len(set(numbers_there)) == len(worlds)
    numbered = zip(numbers_there if unique else range(len(worlds)), worlds, strict=True)
    return Dataset(
        name,
        {
            int(index or 0): partial(single.read_world, file, robot)
            for index, file in numbered
        },
    )


def _own(path: Path) -> Dataset:
    content = own.read_own(path)
    readers = {
        index: partial(content.world, position)
        for position, index in enumerate(content.indices)
    }
    return Dataset(str(content.manifest["name"]), readers, manifest=content.manifest)


LONGEST_SPEC = 10_000
_FORM = re.compile(r"(\d{1,9})(?:-(\d{1,9})|:(\d{1,9})(?::(\d{1,9}))?)?")
_FORMS = "a number, first-last, start:stop or start:stop:step, several joined by commas, or all"


def select_worlds(spec: str, indices: Iterable[int]) -> list[int]:
    """Return the numbers that `spec` selects from `indices`, in its order, each once.

    "7" must exist. The ranges "0-49" (both ends included) and "0:300:6" (like a Python range, end excluded) select the
    numbers that exist, at least one; of a set without gaps all must exist. "1,4,7-9" joins, "all" is all. WorldError
    for anything else.
    """
    known = sorted(set(indices))
    if len(spec) > LONGEST_SPEC:
        raise WorldError(
            f"selection of worlds must have at most {LONGEST_SPEC} characters, got {len(spec)}"
        )
    if not known:
        raise WorldError("there are no worlds to select from")
    return list(
        dict.fromkeys(
            index
            for part in spec.split(",")
            for index in _part(part.strip(), spec, known)
        )
    )


def _part(part: str, spec: str, known: list[int]) -> list[int]:
    if part == "all":
        return known
    match = _FORM.fullmatch(part)
    if match is None:
        raise WorldError(f"worlds {spec!r:.80}: {part!r:.40} is not {_FORMS}")
    first, last, stop, step = match.groups()
    if step and not int(step):
        raise WorldError(
            f"worlds {spec!r:.80}: the step in {part!r} must be at least 1"
        )
    wanted = range(
        int(first), int(stop) if stop else int(last or first) + 1, int(step or 1)
    )
    found = [index for index in known if index in wanted]
    gapless = known[-1] - known[0] == len(known) - 1
    if not found or (gapless and len(found) < len(wanted)):
        beyond = (index for index in wanted if index > known[-1] or index < known[0])
        part = f"{next(beyond)} of {part}" if found else part
        raise WorldError(
            f"worlds {spec!r:.80}: no world {part} among the {len(known)} from {known[0]} to {known[-1]}"
        )
    return found
