"""Maps in the format of map_server: an image and a .yaml file.

They are read like Nav2's map_server in ROS 2 Jazzy reads them, except for transparency:
a pixel that is not opaque is unknown, whatever its color.
"""

import io
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.config import (
    OPTIONAL,
    Checked,
    as_dict,
    from_dict,
    optional,
    quantity,
    required,
)
from barn_worlds.base.errors import (
    BarnError,
    ConfigError,
    WorldError,
    format_error,
    list_names,
    note,
    suggest_similar,
)
from barn_worlds.base.files import (
    as_mapping,
    dump_yaml,
    parse_yaml,
    read_bytes,
    write_bytes,
)
from barn_worlds.base.types import OccupancyMap
from barn_worlds.base.yaml_scalars import TextLoader, parse_flag, parse_numbers
from barn_worlds.geometry.transform import Transform, quaternion_matrix
from barn_worlds.worlds.cells import (
    LARGEST_MAP,
    OCCUPIED,
    lead_in_cells,
    margin_cells,
    world_map,
)

UNKNOWN = -1
LARGEST_YAML = 64 * 1024
MODES = ("trinary", "scale", "raw")
_IMAGE_FORMATS = ("PPM", "PNG", "BMP", "JPEG", "GIF", "TIFF", "WEBP", "TGA", "PCX")
_ORIENTATION = 274  # tag of a TIFF file
_OWN_KEYS = ("start", "goal", "routes")  # unknown to map_server
_NUMBERS = ("resolution", "origin", "occupied_thresh", "free_thresh")
_PARSERS: dict[str, Callable[[str], Any]] = {
    "image": str,
    "mode": str.lower,
    "negate": parse_flag,
}
_ROUTES_HINT = (
    "into the map's YAML file: routes: {name: {start: [x, y, yaw], goal: [x, y]}}"
)
# What files of other programs are, by a text in them.
_OTHER_FILES = {
    b"FeatureCollection": "a GeoJSON file, such as a route graph of Nav2",
    b"building_name:": "a navigation graph of Open-RMF",
    b"elevation:": "a building of Open-RMF's traffic editor, in pixels",
    b"<gpx": "a GPX file, in degrees",
    b"<kml": "a KML file, in degrees",
    b"latitude": "a list of places in degrees",
}
# In the names of Nav2's masks of places to avoid, which are maps in mode trinary, too.
_MASK = re.compile("keepout|mask", re.IGNORECASE)
# Gray values that map_saver writes. That of unknown cells lies between the thresholds.
_FREE_GRAY = 254
_UNKNOWN_GRAY = 205
_OCCUPIED_GRAY = 0
_OCCUPIED_THRESHOLD = 0.65
_FREE_THRESHOLD = 0.196


@dataclass(frozen=True)
class MapRoute(Checked):
    """Start and goal of one route in a map's .yaml file."""

    start: tuple[float, float, float] = required("x, y in m and yaw in rad")
    goal: tuple[float, ...] = required("x, y in m (and yaw in rad)")
    waypoints: Any = None  # declared so that the error can name it

    def check_rules(self) -> None:
        """Raise ConfigError for waypoints, and unless the goal has 2 or 3 numbers."""
        self.require(
            self.waypoints is None,
            "waypoints",
            "are not allowed, because a trial has one goal: write a route to each",
        )
        self.require(
            len(self.goal) in (2, 3), "goal", "must be x and y, or x, y and yaw"
        )


@dataclass(frozen=True)
class Waypoint(Checked):
    """A pose in a file that Nav2's panel in RViz saves."""

    pose: tuple[float, float, float] = required("x, y, z in m")
    orientation: tuple[float, float, float, float] = required("quaternion w, x, y, z")

    def check_rules(self) -> None:
        """Raise ConfigError if all numbers of the orientation are 0."""
        self.require(any(self.orientation), "orientation", "must not be all 0")

    @property
    def numbers(self) -> tuple[float, float, float]:
        """The pose in the plane: x and y in m, yaw in rad."""
        w, x, y, z = self.orientation
        heading = Transform(rotation=quaternion_matrix(x, y, z, w))
        return *self.pose[:2], heading.yaw_rad


@dataclass(frozen=True)
class MapFile(Checked):
    """The .yaml file of a map, with the keys of map_server and a course or routes."""

    image: str = required("name of the image file in the same folder")
    resolution: float = required("size of a cell", "m", 0.005, 10.0)
    origin: tuple[float, float, float] = required(
        "outer corner of the map", "", -1e6, 1e6
    )
    negate: int = required("whether white is occupied", "", 0, 1)
    occupied_thresh: float = required("occupied above this probability", "", 0.0, 1.0)
    free_thresh: float = required("free below this probability", "", 0.0, 1.0)
    mode: str = quantity("trinary", "meaning of gray values", choices=MODES)
    start: tuple[float, ...] = optional((), "x, y in m and yaw in rad of the start")
    goal: tuple[float, ...] = optional((), "x, y in m (and yaw in rad) of the goal")
    # Routes by name, or a file of waypoints. Each route is a world of its own.
    routes: Mapping[str, MapRoute] = field(default_factory=dict, metadata=OPTIONAL)

    def check_rules(self) -> None:
        """Raise ConfigError for an invalid threshold, origin, course or image name."""
        self.require_order("free_thresh", "at most", "occupied_thresh")
        self.require(self.origin[2] == 0.0, "origin", "must have a yaw of 0")
        self.require(
            bool(self.start) == bool(self.goal),
            "start" if self.goal else "goal",
            "must be set, too",
        )
        # `parse_course` gets the numbers of both and cannot tell where one ends.
        self.require(len(self.start) in (0, 3), "start", "must be x, y and yaw")
        self.require(
            len(self.goal) in (0, 2, 3), "goal", "must be x and y, or x, y and yaw"
        )
        self.require(
            not (self.start and self.routes), "start", "must be inside one of routes"
        )
        self.require("\0" not in self.image, "image", "must be the name of a file")


def write_map(
    grid: OccupancyMap, path: Path, image: str = "", course: Sequence[float] = ()
) -> None:
    """Write a map as a map_server .yaml file and a binary PGM image beside it.

    Args:
        grid: Map to write.
        path: The .yaml file, with or without its ending.
        image: Name of the image. By default that of the .yaml file, ending in .pgm.
        course: x, y and yaw of start and goal, (6,), for the .yaml file.

    Raises:
        WorldError: If a file cannot be written.
    """
    yaml_path = path if path.suffix == ".yaml" else path.with_name(f"{path.name}.yaml")
    map_file = MapFile(
        image=image or f"{yaml_path.stem}.pgm",
        resolution=float(grid.resolution),
        origin=(float(grid.origin_x), float(grid.origin_y), 0.0),
        negate=0,
        occupied_thresh=_OCCUPIED_THRESHOLD,
        free_thresh=_FREE_THRESHOLD,
        start=tuple(course[:3]),
        goal=tuple(course[3:]),
    )
    text = dump_yaml(as_dict(map_file))
    # The image comes first, so that a .yaml file never lacks its image.
    height, width = grid.data.shape
    gray = np.select(
        [grid.data == 0, grid.data > 0], [_FREE_GRAY, _OCCUPIED_GRAY], _UNKNOWN_GRAY
    )
    # Images begin with the top row.
    pixels = gray[::-1].astype(np.uint8).tobytes()
    content = f"P5\n{width} {height}\n255\n".encode() + pixels
    write_bytes(path.with_name(map_file.image), content)
    write_bytes(yaml_path, text.encode())


def read_map_file(path: Path) -> MapFile:
    """Read a map's .yaml file without its image; WorldError if it is malformed.

    Keys that neither map_server nor the suite knows are ignored, with a note.
    """
    file = read_bytes(path, LARGEST_YAML)
    try:
        content = parse_yaml(file, str(path))
        if isinstance(content, dict):
            if "image" not in content:
                _refuse_other(file, path)
                if "waypoints" in content:
                    raise WorldError(
                        f"{path}: is not a map; name it in the map's YAML file: "
                        f"routes: {path.name}"
                    )
            if isinstance(content.get("routes"), str):
                content["routes"] = read_legs(path.parent / content["routes"])
            content |= _read_scalars(parse_yaml(file, str(path), TextLoader))
            names = [item.name for item in fields(MapFile)]
            foreign = [key for key in content if key not in names]
            # A misspelled key of the suite must not be ignored.
            ignored = [key for key in foreign if not suggest_similar(key, _OWN_KEYS)]
            for key in ignored:
                del content[key]
            if ignored and "image" in content:
                note(f"{path}: ignored keys, as in map_server: {list_names(ignored)}")
        return from_dict(MapFile, content, str(path))
    except ConfigError as error:
        raise WorldError(str(error)) from None


def read_legs(path: Path) -> dict[str, dict[str, tuple[float, ...]]]:
    """Return routes from each waypoint to the next in a file; WorldError below two.

    Args:
        path: YAML with `waypoints`, as Nav2's panel saves them.

    Returns:
        Start and goal of each route, by its name.

    Raises:
        BarnError: If the file cannot be read or has fewer than two waypoints.
    """
    file = read_bytes(path, LARGEST_YAML)
    _refuse_other(file, path)
    content = as_mapping(parse_yaml(file, str(path)))
    entries = as_mapping(content.get("waypoints"))
    if len(entries) < 2:
        raise WorldError(
            f"{path}: must have two waypoints or more, as Nav2's panel in RViz saves "
            f"them; write the routes of other files {_ROUTES_HINT}"
        )
    poses = {}
    for name, entry in entries.items():
        waypoint = from_dict(Waypoint, as_mapping(entry), f"{path}: {name!s:.60}")
        poses[name] = waypoint.numbers
    return {
        f"{first} to {last}": {"start": poses[first], "goal": poses[last]}
        for first, last in pairwise(poses)
    }


def _refuse_other(content: bytes, path: Path) -> None:
    """Raise WorldError if a file is of another program, which gives no routes."""
    for text, kind in _OTHER_FILES.items():
        if text in content:
            raise WorldError(
                f"{path}: is {kind}; must have two waypoints or more, as Nav2's panel "
                f"in RViz saves them; write other routes {_ROUTES_HINT}"
            )


def read_route_names(path: Path) -> list[str]:
    """Read the names of the routes in a map's .yaml file; [] if it cannot be read."""
    try:
        return list(read_map_file(path).routes)
    except BarnError:
        # The error is raised when the map is loaded.
        return []


def read_map(path: Path, map_file: MapFile | None = None) -> OccupancyMap:
    """Read the map of a .yaml file and its image, flipped so that y rises with rows.

    Args:
        path: The .yaml file.
        map_file: Its content. By default it is read.

    Returns:
        The map, with probabilities from 0 to 100 in the modes scale and raw.

    Raises:
        WorldError: If the .yaml file or the image is malformed.
    """
    map_file = map_file or read_map_file(path)
    image = path.parent / map_file.image
    # Path.is_file would raise an error for names that are too long.
    if not os.path.isfile(image):  # noqa: PTH113
        # Maps that were copied may still name where their image was.
        files = os.listdir(path.parent)  # noqa: PTH208
        similar = get_close_matches(image.name, files, n=1)
        hint = f"; did you mean {similar[0]!r}?" if similar else ""
        raise WorldError(
            f"{path}: image: {map_file.image!r:.200} is not a file; put the image "
            f"there, or change image{hint}"
        )
    gray, is_opaque = _read_image(image)
    data = np.where(is_opaque, _cell_values(gray, map_file), UNKNOWN)
    x, y, _ = map_file.origin
    # Images begin with the top row, which has the largest y.
    return OccupancyMap(data[::-1].astype(np.int8), map_file.resolution, x, y)


def _cell_values(gray: Floats, map_file: MapFile) -> Floats:
    """Return gray pixels (0 to 255) as 0 (free) to 100 (occupied) or -1 by the mode."""
    if map_file.mode == "raw":
        values = np.rint(gray)
        return np.where(values <= OCCUPIED, values, UNKNOWN)

    shade = gray / 255.0
    chance = shade if map_file.negate else 1.0 - shade
    between: Floats | int = UNKNOWN
    if map_file.mode == "scale":
        span = map_file.occupied_thresh - map_file.free_thresh
        share = (chance - map_file.free_thresh) / max(span, 1e-9)
        between = np.rint(100.0 * share)
    return np.select(
        [chance < map_file.free_thresh, chance > map_file.occupied_thresh],
        [0, OCCUPIED],
        between,
    )


def filled_cells(grid: OccupancyMap) -> BoolGrid:
    """Return a mask like a map's data, True where it is surely occupied or unknown.

    A robot may not fit into unknown cells. A probability between the thresholds (mode
    scale) counts as free, as in the static layer of Nav2's costmaps.
    """
    return (grid.data < 0) | (grid.data >= OCCUPIED)


def select_maps(files: Sequence[Path]) -> list[Path]:
    """Return the trinary maps, else maps of other modes; log a note about the rest.

    The others are not maps at all, or are masks: maps in mode scale or raw, or with
    keepout or mask in their names, beside other maps in mode trinary.
    """
    modes = {file: _read_mode(file) for file in files}
    maps = [
        file
        for file, mode in modes.items()
        if mode == "trinary" and not _MASK.search(file.stem)
    ]
    maps = maps or [file for file, mode in modes.items() if mode]
    skipped = [file.name for file in files if file not in maps]
    if skipped:
        note(
            f"{files[0].parent}: skipped masks (mode scale or raw, or keepout or mask "
            "in the name) and other files that are not maps of obstacles: "
            f"{list_names(skipped)}; to use one, name the file instead of the folder"
        )
    return maps


def _read_mode(path: Path) -> str:
    """Read the mode of a map's .yaml file; "trinary" for bad YAML, "" for no map."""
    try:
        content = parse_yaml(read_bytes(path, LARGEST_YAML), str(path), TextLoader)
    except ConfigError:
        # The error is raised when the map is loaded.
        return MODES[0]
    except WorldError:
        return ""
    if not isinstance(content, dict) or "image" not in content:
        return ""
    return str(content.get("mode", MODES[0])).lower()


def _read_scalars(texts: dict[str, Any]) -> dict[str, Any]:
    """Return the values of map_server's keys, converted from text as yaml-cpp does.

    yaml-cpp does not distinguish quoted scalars from plain ones.
    """
    scalars = {key: parse_numbers(texts[key]) for key in _NUMBERS if key in texts}
    for key, parse in _PARSERS.items():
        if isinstance(texts.get(key), str):
            scalars[key] = parse(texts[key])
    return scalars


def extract_grid(grid: OccupancyMap) -> BoolGrid | None:
    """Return the grid (rows, cols) of the BARN world that a map shows, or None.

    The map must show the containment. Its obstacles may be in their true positions or
    one cell too near, as in the original maps. The result is None for other maps.
    """
    is_filled = filled_cells(grid)
    height, width = is_filled.shape
    resolution_m = grid.resolution
    lead_in = lead_in_cells(resolution_m)
    cols = height - lead_in - margin_cells(resolution_m)
    right_m = grid.origin_x + width * resolution_m
    # The map of a BARN world ends at x = 0 and begins at y = 0.
    if cols < 1 or abs(right_m) >= 1e-6 or abs(grid.origin_y) >= 1e-6:
        return None

    candidates = []
    for historical in (False, True):
        # Historical maps have the field one cell nearer to the start.
        first = lead_in - historical
        field: BoolGrid = np.ascontiguousarray(is_filled[first : first + cols].T)
        expected = world_map(field, resolution_m, historical=historical)
        if np.array_equal(expected.data != 0, is_filled):
            candidates.append(field)
    # If both fit, one of them has an empty last column, without side walls.
    return max(candidates, key=lambda field: bool(field[[0, -1]].all()), default=None)


def _read_image(path: Path) -> tuple[Floats, BoolGrid]:
    """Return an image's gray (0 to 255) and mask of opaque pixels, the top row first.

    Both are (height, width) and begin with the top row. A color counts as its mean.
    WorldError if the file is not such an image or is too large.
    """
    # Imported here because most worlds are not images.
    from PIL import Image  # noqa: PLC0415

    content = read_bytes(path)
    try:
        with Image.open(io.BytesIO(content), formats=_IMAGE_FORMATS) as image:
            if image.width * image.height > LARGEST_MAP:
                raise ValueError(
                    f"must have at most {LARGEST_MAP} pixels, got {image.size}"
                )
            if image.format == "TIFF":
                # Pillow would turn the image as the file asks; map_server does not.
                image.getexif()[_ORIENTATION] = 1
            if image.mode.startswith("I") and "transparency" not in image.info:
                # 16 bits of gray.
                gray: Floats = np.asarray(image, np.float64) / 257.0
                if gray.max(initial=0.0) > 255.0 or gray.min(initial=0.0) < 0.0:
                    raise ValueError("must have at most 16 bits of gray")
                return gray, np.ones(gray.shape, np.bool_)
            if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK"):
                raise ValueError(f"pixels of mode {image.mode} are not supported")
            pixels = np.asarray(image.convert("RGBA"), np.float64)
    # Pillow raises errors of any kind for malformed bytes.
    except Exception as error:
        raise WorldError(
            f"{path}: not a readable image ({', '.join(_IMAGE_FORMATS)}): "
            f"{format_error(error)}"
        ) from None
    return pixels[..., :3].mean(axis=2), pixels[..., 3] == 255.0
