"""Maps in the format of map_server: an 8-bit grey image and a .yaml file."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.config import (
    Checked,
    as_dict,
    from_dict,
    optional,
    quantity,
    required,
)
from barn_worlds.base.errors import ConfigError, WorldError, format_error
from barn_worlds.base.files import read_bytes, write_bytes
from barn_worlds.base.text_files import parse_yaml
from barn_worlds.base.types import OccupancyMap
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.cells import LARGEST_MAP, OCCUPIED, world_map

UNKNOWN = -1
LARGEST_YAML = 64 * 1024
LARGEST_IMAGE = 256 * 1024 * 1024
_IMAGE_FORMATS = ("PPM", "PNG", "BMP")
_FREE, _UNKNOWN, _OCCUPIED = 254, 205, 0  # grey


@dataclass(frozen=True)
class MapFile(Checked):
    """What map_server's .yaml file says."""

    image: str = required("name of the image file beside it")
    resolution: float = required("size of a cell", "m", 0.005, 10.0)
    origin: tuple[float, float, float] = required(
        "outer corner of the map", "", -1e6, 1e6
    )
    negate: int = required("whether white is occupied", "", 0, 1)
    occupied_thresh: float = required("occupied above this chance", "", 0.0, 1.0)
    free_thresh: float = required("free below this chance", "", 0.0, 1.0)
    mode: str = quantity("trinary", "how grey values are read", choices=("trinary",))
    start: tuple[float, ...] = optional(
        (), "x, y in m and yaw in rad of a world's start"
    )
    goal: tuple[float, ...] = optional((), "x, y in m (and yaw in rad) of its goal")

    def __post_init__(self) -> None:
        super().__post_init__()
        most = f"must be at most occupied_thresh ({self.occupied_thresh:g})"
        self.require(self.free_thresh <= self.occupied_thresh, "free_thresh", most)
        self.require(self.origin[2] == 0.0, "origin", "must have a yaw of 0")
        self.require(
            bool(self.start) == bool(self.goal),
            "start" if self.goal else "goal",
            "must be given, too",
        )
        self.require(len(self.start) in (0, 3), "start", "must be x, y and yaw")
        self.require(
            len(self.goal) in (0, 2, 3), "goal", "must be x and y, or x, y and yaw"
        )
        self.require("\0" not in self.image, "image", "must be the name of a file")


def write_map(
    grid: OccupancyMap, path: Path, image: str = "", course: Sequence[float] = ()
) -> None:
    """Write a map as NAME.yaml (`path`, with or without the ending) and the image NAME.pgm (or `image`).

    course: x, y and yaw of start and goal, which are kept with it.
    """
    target = path if path.suffix == ".yaml" else path.with_name(path.name + ".yaml")
    origin = float(grid.origin_x), float(grid.origin_y), 0.0
    # the grey value of unknown cells lies between the thresholds
    thresholds, ends = (0.65, 0.196), (tuple(course[:3]), tuple(course[3:]))
    about = MapFile(
        image or f"{target.stem}.pgm",
        float(grid.resolution),
        origin,
        0,
        *thresholds,
        "trinary",
        *ends,
    )
    write_bytes(target.with_name(about.image), pgm(grid))
    write_bytes(target, yaml.safe_dump(as_dict(about), sort_keys=False).encode())


def pgm(grid: OccupancyMap) -> bytes:
    """Return a map as a binary PGM image, its last row (the largest y) at the top."""
    height, width = grid.data.shape
    grey = np.select(
        [grid.data == 0, grid.data > 0], [_FREE, _OCCUPIED], _UNKNOWN
    ).astype(np.uint8)
    return f"P5\n{width} {height}\n255\n".encode() + grey[::-1].tobytes()


def read_map_file(path: Path) -> MapFile:
    """Return what a .yaml file says; WorldError if it is malformed."""
    try:
        return from_dict(
            MapFile, parse_yaml(read_bytes(path, LARGEST_YAML), str(path)), str(path)
        )
    except ConfigError as error:
        raise WorldError(str(error)) from None


def read_map(path: Path, about: MapFile | None = None) -> OccupancyMap:
    """Return the map of a .yaml file in map_server's trinary mode; WorldError if it is malformed.

    about: what `read_about` has already read of it.
    """
    about = about or read_map_file(path)
    shade = _read_image(path.parent / about.image)[::-1] / 255.0
    chance = shade if about.negate else 1.0 - shade
    data = np.select(
        [chance < about.free_thresh, chance > about.occupied_thresh],
        [0, OCCUPIED],
        UNKNOWN,
    )
    return OccupancyMap(data.astype(np.int8), about.resolution, *about.origin[:2])


def extract_grid(grid: OccupancyMap) -> BoolGrid | None:
    """Return the grid (rows, cols) of the world that a map shows with its containment, None for any other map.

    The obstacles may be in their true places or one cell too near, as in the original maps.
    """
    filled = grid.data != 0
    height, width = filled.shape
    cols = (
        height
        - geometry.lead_in_cells(grid.resolution)
        - geometry.margin_cells(grid.resolution)
    )
    if (
        cols < 1
        or abs(grid.origin_x + width * grid.resolution) >= 1e-6
        or abs(grid.origin_y) >= 1e-6
    ):
        return None
    candidates = []
    for historical in (False, True):
        front = geometry.lead_in_cells(grid.resolution) - historical
        inside: BoolGrid = np.ascontiguousarray(filled[front : front + cols].T)
        if np.array_equal(
            world_map(inside, grid.resolution, historical=historical).data != 0, filled
        ):
            candidates.append(inside)
    # If both fit, one of them has an empty last column, without side walls.
    return max(candidates, key=lambda inside: bool(inside[[0, -1]].all()), default=None)


def _read_image(path: Path) -> Floats:
    """Return the grey values (height, width) from 0 to 255 of an image, its top row first."""
    from PIL import Image  # noqa: PLC0415 (most worlds are no images)

    content = read_bytes(path, LARGEST_IMAGE)
    try:
        with Image.open(io.BytesIO(content), formats=_IMAGE_FORMATS) as image:
            if image.width * image.height > LARGEST_MAP:
                raise ValueError(
                    f"must have at most {LARGEST_MAP} pixels, got {image.size}"
                )
            if image.mode not in ("1", "L", "RGB"):
                raise ValueError(
                    f"must be grey or RGB with 8 bits and opaque, got mode {image.mode}"
                )
            pixels = np.asarray(
                image if image.mode == "RGB" else image.convert("L"), np.float64
            )
    except (
        Exception
    ) as error:  # the library raises errors of any kind for malformed bytes
        kinds = ", ".join(_IMAGE_FORMATS)
        raise WorldError(
            f"{path}: not an image that can be read ({kinds}): {format_error(error)}"
        ) from None
    grey: Floats = pixels.mean(axis=2) if pixels.ndim == 3 else pixels
    return grey
