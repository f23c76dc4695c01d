"""Reads worlds of cylinders from Gazebo files (.world, .sdf, gzipped or not)."""

import math
import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from barn_worlds.base.arrays import BoolGrid, Cells, Points
from barn_worlds.base.errors import WorldError, read_numbers
from barn_worlds.base.files import read_maybe_gzipped
from barn_worlds.formats.sdf_frames import Scope
from barn_worlds.geometry.transform import Transform
from barn_worlds.worlds.cells import (
    cell_centers,
    containing_cells,
    containment_cells,
    hollow_cells,
)
from barn_worlds.worlds.cspace import label_regions
from barn_worlds.worlds.world import LARGEST_SIDE

LARGEST_WORLD_FILE = 128 * 1024 * 1024  # unpacked
MOST_TAGS = 1_000_000  # a hundred times those of a world of the paper
OFF_GRID_M = 1e-3  # largest distance of a cylinder from the center of its cell
LARGEST_TILT_RAD = 1e-3  # of a cylinder; moves the top of one of 1 m by 1 mm
# Cylinders must extend through this height, so that robots meet them.
ROBOT_HEIGHT_M = 0.1
# Addresses of models without obstacles, local or of Fuel, which adds version and file.
_WITHOUT_OBSTACLES = re.compile(
    r"(.*/)?(sun|ground[ _]plane)(/(\d+|tip))?(/files/model\.sdf)?/?", re.IGNORECASE
)

_NO_BITS = re.compile(r"\s*(0x)?0+\s*", re.IGNORECASE)


class GazeboFile:
    """The content of a Gazebo world file.

    Methods raise WorldError for content that the suite does not support.
    """

    def __init__(self, content: bytes, where: str):
        """Parse SDF; WorldError for bad XML, a document type or too many tags.

        Args:
            content: Text of the file.
            where: Path of the file, to begin an error message with.
        """
        self._where = where
        # End of an error message, if a saved scale may explain the error.
        self._scale_hint = ""
        if content.count(b"<") > MOST_TAGS:
            raise self._error(f"more than {MOST_TAGS} tags")
        # Entities could expand to gigabytes or name files of the host.
        try:
            self._root: Element = fromstring(content, forbid_dtd=True)
        except DefusedXmlException:
            raise self._error("document types and entities are not allowed") from None
        except (ParseError, ValueError, LookupError) as error:
            raise self._error(f"not well-formed XML: {error}") from None

    @classmethod
    def read(cls, path: Path) -> "GazeboFile":
        """Read and parse a .world or .sdf file, gzipped or not; WorldError if bad."""
        return cls(read_maybe_gzipped(path, LARGEST_WORLD_FILE), str(path))

    def course(self) -> list[float]:
        """Return x, y, yaw of start, then goal; [] for neither, WorldError for one."""
        course: list[float] = []
        for name in ("start", "goal"):
            if self._world.element.find(f"frame[@name='{name}']") is None:
                continue
            pose = self._world.frame(name)
            _require_upright(pose, f"{self._where}: frame {name!r}")
            course += [*pose.offset[:2].tolist(), pose.yaw_rad]
        if len(course) == 3:
            raise self._error("must have both frames start and goal, or neither")
        return course

    def grid(self) -> tuple[BoolGrid, float]:
        """Return a BARN world's grid (rows, cols) and cell size (m), or WorldError.

        All cylinders must have the same radius, half a cell, and stand at the positions
        of cells in `worlds.cells`. The grid ends with the last row and column that have
        a cylinder. The containment may be missing, but only as a whole. Cells that the
        file leaves out because they are surrounded are filled (`fill_hollow`).
        """
        centers_m, radii_m = self.cylinders
        resolution_m = self._cell_size(radii_m)
        # The right wall of a BARN world is at x = 0; all cells have a negative x.
        width = -centers_m[:, 0].min() / resolution_m
        length = centers_m[:, 1].max() / resolution_m
        rows = max(1, math.ceil(width - OFF_GRID_M / resolution_m))
        if rows > LARGEST_SIDE or length > 2 * LARGEST_SIDE:
            farthest = centers_m[np.abs(centers_m).argmax() // 2].tolist()
            raise self._error(f"a cylinder at {farthest} m is too far out")

        cells = containing_cells(centers_m, rows, resolution_m)
        off_m = np.abs(cell_centers(cells, rows, resolution_m) - centers_m).max(axis=1)
        outside = (cells[:, 0] >= rows) | (off_m > OFF_GRID_M)
        if outside.any():
            position = centers_m[np.argmax(outside)].tolist()
            raise self._error(
                f"cylinder at {position} m is not on the grid of "
                f"{resolution_m:g} m cells left of x = 0{self._scale_hint}"
            )

        # Columns below 0 are in front of the field, where robots start.
        in_field = cells[:, 1] >= 0
        self._check_containment(cells[~in_field], rows, resolution_m)
        field = cells[in_field]
        if not len(field):
            raise self._error("no cylinders beyond the containment; the field is empty")
        cols = int(field[:, 1].max()) + 1
        if cols > LARGEST_SIDE:
            raise self._error(
                f"the field must be at most {LARGEST_SIDE} cells long, got {cols}"
            )
        visible = np.zeros((rows, cols), np.bool_)
        visible[tuple(field.T)] = True
        return fill_hollow(visible), resolution_m

    def open_grid(
        self, start: Sequence[float]
    ) -> tuple[BoolGrid, float, tuple[float, float]] | None:
        """Return grid, cell size and corner in m of a world unlike BARN's, or None.

        Args:
            start: x and y in meters of a free place.

        Returns:
            Grid (rows, cols), size of its cells and its outer corner in m. None if the
            cylinders are not on a grid, or all are left of x = 0 as in BARN worlds.
        """
        centers_m, radii_m = self.cylinders
        # The outermost cylinders define the grid, since nothing else in the file does.
        side_m = round(2.0 * radii_m[0], 9)
        corner_m = centers_m.min(axis=0) - 0.5 * side_m
        size = np.ptp(centers_m, axis=0).max() / side_m
        cells = np.round((centers_m - corner_m) / side_m - 0.5).astype(np.int64)
        off_m = np.abs((cells + 0.5) * side_m + corner_m - centers_m).max()
        if (
            centers_m[:, 0].max() <= 0.0
            or off_m + np.ptp(radii_m) > OFF_GRID_M
            or not 0.01 <= side_m <= 10.0
            or size >= LARGEST_SIDE
        ):
            return None

        visible = np.zeros(cells.max(axis=0) + 1, np.bool_)
        visible[tuple(cells.T)] = True
        last = np.array(visible.shape) - 1
        free = np.clip((np.array(start) - corner_m) // side_m, 0, last)
        row, column = free.astype(int).tolist()
        x_m, y_m = corner_m.tolist()
        return fill_hollow(visible, (row, column)), side_m, (x_m, y_m)

    @cached_property
    def cylinders(self) -> tuple[Points, list[float]]:
        """Centers (n, 2) and n radii (m), by any saved state; WorldError if none."""
        cylinders: list[tuple[float, float, float]] = []
        try:
            for model, scale in self._world.models():
                if scale != 1.0 and not self._scale_hint:
                    name = model.element.get("name", "")
                    self._scale_hint = (
                        f"; <state> scales model {name!r:.60} by {scale:g}: write "
                        "<scale>1 1 1</scale> there, or space cylinders to match"
                    )
                cylinders += self._read_model(model, scale)
        except RecursionError:
            raise self._error("models are nested too deeply") from None
        if not cylinders:
            raise self._error("contains no cylinders")
        return np.array(cylinders)[:, :2], [radius for _, _, radius in cylinders]

    @cached_property
    def _world(self) -> Scope:
        """The world after its saved state's changes; WorldError for foreign parts."""
        worlds = self._root.findall("world")
        if self._root.tag != "sdf" or len(worlds) != 1:
            raise self._error(
                "must be <sdf> with one <world>, "
                f"got <{self._root.tag:.60}> with {len(worlds)}"
            )
        version = self._root.get("version", "1.6")
        if not version.strip().startswith("1."):
            raise self._error(f"version of <sdf> must be 1.x, got {version!r:.60}")
        world = worlds[0]
        # Gazebo Classic applies only the first state: insertions, then deletions.
        state = world.find("state")
        if state is None:
            state = Element("state")
        world.extend(state.findall("insertions/*"))
        deleted = {name.text for name in state.iterfind("deletions/name")}
        for model in world.findall("model"):
            if model.get("name") in deleted:
                world.remove(model)

        for element in world:
            if element.tag in ("actor", "population"):
                raise self._error(
                    f"<{element.tag}> cannot be part of a world of cylinders"
                )
            # Models in the world are read; included models are in other files.
            uri = element.findtext("uri", "").strip()
            is_known = _WITHOUT_OBSTACLES.fullmatch(unquote(uri))
            if element.tag == "include" and not is_known:
                raise self._error(
                    f"included model {uri!r:.80} is unknown; known: sun, ground_plane; "
                    "write the model itself there, or save a map of the world"
                )
        return Scope(world, self._where, Transform(), state)

    def _read_model(
        self, model: Scope, scale: float
    ) -> Iterator[tuple[float, float, float]]:
        """Yield x, y, radius in m of a model's cylinders; WorldError for other shapes.

        Args:
            model: The model.
            scale: Factor on radii.
        """
        where = model.where
        if model.element.find("include") is not None:
            raise WorldError(
                f"{where}: <include> inside a model is not supported; write the model "
                "itself there, or save a map of the world and name its YAML file"
            )
        for inner_model, inner_scale in model.models():
            yield from self._read_model(inner_model, inner_scale)
        for link in model.element.findall("link"):
            link_pose = model.locate(link)
            for collision in link.findall("collision"):
                pose = model.locate(collision, link_pose)
                yield from _read_collision(collision, pose, scale, where)

    def _cell_size(self, radii_m: list[float]) -> float:
        """Return the cylinders' diameter (m); WorldError if unequal or extreme."""
        radius_m = radii_m[0]
        for other_m in radii_m:
            if abs(other_m - radius_m) > 1e-6:
                raise self._error(
                    "all cylinders must have the same radius, "
                    f"got {radius_m:g} m and {other_m:g} m{self._scale_hint}"
                )
        # Removes rounding errors of the program that wrote the file.
        resolution_m = round(2.0 * radius_m, 9)
        if not 0.01 <= resolution_m <= 10.0:
            raise self._error(
                f"radius of a cylinder must be from 0.005 to 5 m, got {radius_m:g} m"
            )
        return resolution_m

    def _check_containment(self, cells: Cells, rows: int, resolution_m: float) -> None:
        """Raise WorldError if cells in front of the field are not its containment.

        No cells are allowed, too.

        Args:
            cells: Row and column (n, 2) of the cylinders in front of the field.
            rows: Rows of the field.
            resolution_m: Size of a cell.
        """
        expected = set(map(tuple, containment_cells(rows, resolution_m).tolist()))
        actual = set(map(tuple, cells.tolist()))
        problems = dict.fromkeys(sorted(actual - expected), "a cylinder stands")
        # A file may have no containment, but not a part of one.
        if actual:
            for cell in sorted(expected - actual):
                problems[cell] = "a cylinder of the containment is missing"
        for cell, problem in problems.items():
            center_m = cell_centers(np.array([cell]), rows, resolution_m)[0]
            raise self._error(
                f"{problem} at {center_m.round(6).tolist()} m, in front of the field, "
                "where only the containment is allowed"
            )

    def _error(self, problem: str) -> WorldError:
        """Return (do not raise) a WorldError that begins with the file's path."""
        return WorldError(f"{self._where}: {problem}")


def fill_hollow(visible: BoolGrid, free: tuple[int, int] | None = None) -> BoolGrid:
    """Return a copy with enclosed gaps filled where the file allows it, not at `free`.

    A file leaves out filled cells whose 8 neighbors are all filled. An enclosed gap may
    consist of such cells or be empty: the file looks the same. But if filling a gap
    surrounds a cell that the file shows, the gap is empty. So every enclosed gap is
    filled unless that contradicts the file, the largest first.

    This recovers all but 2 of 18 000 generated worlds and all of the 50 shared
    originals. An error has no effect: neither robots nor rays get into such a gap, and
    a gap of up to 4 x 4 cells is occupied in the C-space of a Jackal anyway.

    Args:
        visible: Cells that the file shows, True where filled.
        free: Row and column of a cell whose gap stays empty.
    """
    # Imported here, as by `label_regions`.
    from scipy.ndimage import find_objects  # noqa: PLC0415

    grid: BoolGrid = visible.copy()
    labels, sizes = label_regions(~visible, 8)
    boxes = find_objects(labels)
    for index in np.argsort(-sizes[1:], kind="stable").tolist():
        label = index + 1
        is_enclosed = free is None or labels[free] != label
        around = []
        for span, side in zip(boxes[index], visible.shape, strict=True):
            is_enclosed &= span.start > 0 and span.stop < side
            around.append(slice(max(0, span.start - 2), span.stop + 2))
        if not is_enclosed:
            continue

        # A view of the cells of the gap and of those that filling it may surround.
        place = tuple(around)
        part = grid[place]
        gap = labels[place] == label
        part[gap] = True
        if (hollow_cells(part) & visible[place]).any():
            part[gap] = False
    return grid


def _read_collision(
    collision: Element, pose: Transform, scale: float, where: str
) -> Iterator[tuple[float, float, float]]:
    """Yield x, y, radius of a cylinder, nothing for plane or empty; else WorldError.

    Shapes without contact bits yield nothing: robots drive through them. WorldError for
    other shapes and for cylinders that robots would not meet.

    Args:
        collision: The element.
        pose: Its pose in the world.
        scale: Factor on the radius.
        where: Path of the file and name of the model, to begin messages with.
    """
    bits = collision.findtext("surface/contact/collide_bitmask", "65535")
    category_bits = collision.findtext("surface/contact/category_bitmask", bits)
    if _NO_BITS.fullmatch(bits) and _NO_BITS.fullmatch(category_bits):
        return
    passable = collision.findtext("surface/contact/collide_without_contact", "false")
    if passable.strip().lower() in ("true", "1"):
        raise WorldError(
            f"{where}: collide_without_contact must be false, got {passable!r:.60}: "
            "Gazebo Classic lets robots through, current Gazebo does not; to let robots "
            "through, write <collide_bitmask>0</collide_bitmask> instead"
        )
    shapes = collision.findall("geometry/*")
    kinds = [str(shape.tag) for shape in shapes]
    if kinds in (["plane"], ["empty"]):
        return
    if kinds != ["cylinder"]:
        names = ", ".join(kinds)[:60] or "none"
        raise WorldError(
            f"{where}: shape must be one cylinder, got {names}; for other shapes, "
            "save a map of the world with Nav2's map_saver and name its YAML file"
        )
    _require_upright(pose, where)
    (radius,) = read_numbers(shapes[0].findtext("radius"), 1, f"{where}: radius")
    (length,) = read_numbers(shapes[0].findtext("length", "1"), 1, f"{where}: length")
    if min(radius, length) <= 0.0:
        raise WorldError(
            f"{where}: radius and length must be above 0, got {radius:g}, {length:g}"
        )
    x, y, z = pose.offset.tolist()
    if abs(z - ROBOT_HEIGHT_M) > 0.5 * length:
        raise WorldError(
            f"{where}: a cylinder from {z - 0.5 * length:g} to {z + 0.5 * length:g} m "
            f"above the ground does not extend through {ROBOT_HEIGHT_M:g} m, "
            "where robots would meet it"
        )
    yield x, y, scale * radius


def _require_upright(pose: Transform, where: str) -> None:
    """Raise WorldError for a pose in the world whose z axis is not upright."""
    if pose.tilt_rad > LARGEST_TILT_RAD:
        raise WorldError(
            f"{where}: leans by {pose.tilt_rad:.3g} rad; "
            f"at most {LARGEST_TILT_RAD:g} is allowed"
        )
