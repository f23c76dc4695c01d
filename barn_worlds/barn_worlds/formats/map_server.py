"""Maps in the format of map_server: an 8-bit grey image and a .yaml file."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.errors import ConfigError, WorldError, one_line, shown
from barn_worlds.base.files import read_bytes, write_bytes
from barn_worlds.base.text_files import parse_yaml
from barn_worlds.base.types import OccupancyMap
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.cells import LARGEST_MAP, OCCUPIED, world_map

UNKNOWN = -1
LARGEST_YAML = 64 * 1024
LARGEST_IMAGE = 256 * 1024 * 1024
_LONGEST_NAME = 255
_IMAGE_FORMATS = ("PPM", "PNG", "BMP")
_RESOLUTIONS = 0.005, 10.0
# The grey value of unknown cells, 205, lies between the two.
_OCCUPIED_THRESHOLD, _FREE_THRESHOLD = 0.65, 0.196
_GREY = {"free": 254, "unknown": 205, "occupied": 0}


def write_map(grid: OccupancyMap, path: Path, image: str = "") -> None:
    """Write a map as NAME.yaml (`path`, with or without the ending) and the image NAME.pgm (or `image`)."""
    target = path if path.suffix == ".yaml" else path.with_name(path.name + ".yaml")
    image = image or f"{target.stem}.pgm"
    about = {
        "image": image,
        "mode": "trinary",
        "resolution": float(grid.resolution),
        "origin": [float(grid.origin_x), float(grid.origin_y), 0.0],
        "negate": 0,
        "occupied_thresh": _OCCUPIED_THRESHOLD,
        "free_thresh": _FREE_THRESHOLD,
    }
    write_bytes(target.with_name(image), pgm(grid))
    write_bytes(target, yaml.safe_dump(about, sort_keys=False).encode())


def pgm(grid: OccupancyMap) -> bytes:
    """Return a map as a binary PGM image, its last row (the largest y) at the top."""
    height, width = grid.data.shape
    grey = np.full((height, width), _GREY["unknown"], np.uint8)
    grey[grid.data == 0] = _GREY["free"]
    grey[grid.data > 0] = _GREY["occupied"]
    return f"P5\n{width} {height}\n255\n".encode() + grey[::-1].tobytes()


def read_map(path: Path) -> OccupancyMap:
    """Return the map of a .yaml file in map_server's trinary mode; WorldError if it is malformed."""
    about = _read_yaml(path)
    resolution = _number(about, "resolution", path, *_RESOLUTIONS)
    occupied = _number(about, "occupied_thresh", path, 0.0, 1.0)
    free = _number(about, "free_thresh", path, 0.0, 1.0)
    negate = _number(about, "negate", path, 0, 1)
    if free > occupied:
        raise WorldError(f"{path}: free_thresh must be at most occupied_thresh ({occupied:g}), got {free:g}")
    if about.get("mode", "trinary") != "trinary":
        raise WorldError(f"{path}: mode must be trinary, got {shown(about['mode'])}")
    x, y = _origin(about.get("origin"), path)
    image = about.get("image")
    if not isinstance(image, str) or not 0 < len(image) <= _LONGEST_NAME or "\0" in image:
        raise WorldError(f"{path}: image must be the name of an image file, got {shown(image)}")
    shade = _read_image(path.parent / image)[::-1] / 255.0
    chance = shade if negate else 1.0 - shade
    data = np.full(shade.shape, UNKNOWN, np.int8)
    data[chance > occupied] = OCCUPIED
    data[chance < free] = 0
    return OccupancyMap(data, resolution, x, y)


def read_resolution(path: Path) -> float:
    """Return the resolution in metres that a .yaml file states."""
    return _number(_read_yaml(path), "resolution", path, *_RESOLUTIONS)


def grid_of(grid: OccupancyMap) -> BoolGrid:
    """Return the grid (rows, cols) of a world from a map; unknown cells count as filled.

    A map of a whole world, with its containment, gives that world's grid. The obstacles may be in their true places or
    one cell too near, as in the original maps. Any other map is taken as it is: rows along x.
    """
    filled = grid.data != 0
    height, width = filled.shape
    cols = height - geometry.lead_in_cells(grid.resolution) - geometry.margin_cells(grid.resolution)
    candidates = []
    if cols >= 1 and abs(grid.origin_x + width * grid.resolution) < 1e-6 and abs(grid.origin_y) < 1e-6:
        for historical in (False, True):
            front = geometry.lead_in_cells(grid.resolution) - historical
            inside: BoolGrid = np.ascontiguousarray(filled[front : front + cols].T)
            whole = world_map(inside, grid.resolution, historical=historical).data != 0
            if np.array_equal(whole, filled):
                candidates.append(inside)
    if not candidates:
        return np.ascontiguousarray(filled.T)
    # If both fit, one of them has an empty last column, without side walls.
    walled = [inside for inside in candidates if inside[[0, -1]].all()]
    return (walled or candidates)[0]


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        about = parse_yaml(read_bytes(path, LARGEST_YAML), str(path))
    except ConfigError as error:
        raise WorldError(str(error)) from None
    if not isinstance(about, dict):
        raise WorldError(f"{path}: must be a mapping of names to values")
    return about


def _read_image(path: Path) -> Floats:
    """Return the grey values (height, width) from 0 to 255 of an image, its top row first."""
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 (most worlds are no images)

    try:
        with Image.open(io.BytesIO(read_bytes(path, LARGEST_IMAGE)), formats=_IMAGE_FORMATS) as image:
            if image.width * image.height > LARGEST_MAP:
                raise WorldError(f"{path}: image must have at most {LARGEST_MAP} pixels, got {image.size}")
            if image.mode not in ("1", "L", "RGB"):
                raise WorldError(f"{path}: image must be grey or RGB with 8 bits and opaque, got mode {image.mode}")
            pixels = np.asarray(image if image.mode == "RGB" else image.convert("L"), np.float64)
    except UnidentifiedImageError:
        raise WorldError(f"{path}: not a {', '.join(_IMAGE_FORMATS)} image") from None
    except Image.DecompressionBombError:
        raise WorldError(f"{path}: image must have at most {LARGEST_MAP} pixels") from None
    except WorldError:
        raise
    except Exception as error:  # the library raises errors of any kind for malformed bytes
        raise WorldError(f"{path}: damaged image: {one_line(error)}") from None
    grey: Floats = pixels.mean(axis=2) if pixels.ndim == 3 else pixels
    return grey


def _number(about: dict[str, Any], key: str, path: Path, low: float, high: float) -> float:
    value = about.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise WorldError(f"{path}: {key} must be a number from {low:g} to {high:g}, got {shown(value)}")
    return float(value)


def _origin(value: object, path: Path) -> tuple[float, float]:
    numbers = value if isinstance(value, list) else []
    good = len(numbers) == 3 and all(isinstance(number, (int, float)) for number in numbers)
    if not good or not all(abs(number) < 1e6 for number in numbers):
        raise WorldError(f"{path}: origin must be three finite numbers [x, y, yaw], got {shown(value)}")
    if numbers[2] != 0:
        raise WorldError(f"{path}: the origin's yaw must be 0, got {numbers[2]:g}")
    return float(numbers[0]), float(numbers[1])
