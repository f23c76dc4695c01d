"""map_server's maps: thresholds, images, worlds there and back, and the malformed refused."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from PIL import Image
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.base.types import OccupancyMap
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.map_server import (
    extract_grid,
    filled_cells,
    read_map,
    read_map_file,
    read_route_names,
    select_maps,
    write_map,
)
from barn_worlds.formats.single import read_world
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.worlds.world import World

YAML = "image: m.pgm\nresolution: 0.1\norigin: [1.0, -2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
PGM = b"P5\n# made by hand\n3 2\n255\n" + bytes([0, 89, 90, 191, 192, 255])


def save(folder, yaml=YAML, pgm=PGM):
    (folder / "m.yaml").write_bytes(yaml.encode() if isinstance(yaml, str) else yaml)
    (folder / "m.pgm").write_bytes(pgm)
    return folder / "m.yaml"


def with_keys(lines):
    """The description with the keys in these lines instead of its own."""
    keys = tuple(line.partition(" ")[0] for line in lines.splitlines())
    own = [line for line in YAML.splitlines() if not line.startswith(keys)]
    return "\n".join([*own, lines])


def test_thresholds_are_honoured(tmp_path):
    grid = read_map(save(tmp_path))
    # chance of being occupied, upper image row: 1, 0.651, 0.647; lower, which is data[0]: 0.2510, 0.2471, 0
    assert grid.data.tolist() == [[-1, 0, 0], [100, 100, -1]]
    assert (grid.resolution, *grid.origin) == (0.1, 1.0, -2.0)
    negated = read_map(save(tmp_path, YAML.replace("negate: 0", "negate: 1")))
    assert negated.data.tolist() == [[100, 100, 100], [0, -1, -1]]


@given(
    npst.arrays(
        np.int8,
        st.tuples(st.integers(1, 9), st.integers(1, 9)),
        elements=st.sampled_from([-1, 0, 100]),
    ),
    st.sampled_from([0.05, 0.15, 1.0]),
    st.floats(-1000, 1000),
)
def test_maps_come_back(tmp_path_factory, data, resolution, x):
    path = tmp_path_factory.mktemp("map") / "a.b"
    write_map(OccupancyMap(data, resolution, x, -x), path)
    read = read_map(path.with_name("a.b.yaml"))
    assert np.array_equal(read.data, data)
    assert (read.resolution, *read.origin) == (resolution, x, -x)


def test_a_plain_image_gives_the_same_map(tmp_path):
    expected = read_map(save(tmp_path)).data
    path = save(tmp_path, pgm=b"P2\n3 2\n255\n0 89 90 191 192 255\n")
    assert np.array_equal(read_map(path).data, expected)


def test_images_of_one_bit_are_read(tmp_path):
    path = save(tmp_path, pgm=b"P4\n3 2\n\xe0\x00")
    Image.open(tmp_path / "m.pgm").save(tmp_path / "m.pgm", "png")
    assert read_map(path).data.tolist() == [[0, 0, 0], [100, 100, 100]]


IMAGES = """
L png, L bmp, RGB ppm, P png, P gif, LA png, RGBA png, RGBA tiff, RGBA tga,
I;16 png, I;16 tiff, I;16 ppm
"""


@pytest.mark.parametrize("mode, kind", [image.split() for image in IMAGES.split(",")])
def test_every_mode_of_an_opaque_image_gives_the_same_map(tmp_path, mode, kind):
    expected = read_map(save(tmp_path)).data
    gray = Image.open(tmp_path / "m.pgm")
    if mode == "I;16":
        image = Image.fromarray(257 * np.asarray(gray, np.uint16))
    else:
        image = gray.convert(mode)
    # map_server does not turn images as an orientation asks.
    turned = {"tiffinfo": {274: 3}} if kind == "tiff" else {}
    image.save(tmp_path / "m.pgm", kind, **turned)
    assert np.array_equal(read_map(tmp_path / "m.yaml").data, expected)


def test_a_jpeg_of_flat_areas_gives_the_same_map(tmp_path):
    pixels = np.full((32, 48), 254, np.uint8)
    pixels[:16, 16:32] = 0
    Image.fromarray(pixels).save(tmp_path / "m.pgm", "jpeg", quality=100)
    (tmp_path / "m.yaml").write_text(YAML)
    expected = np.where(pixels[::-1] == 0, 100, 0)
    assert np.array_equal(read_map(tmp_path / "m.yaml").data, expected)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("transparency", ["alpha", "palette"])
def test_what_is_not_opaque_is_unknown(tmp_path, transparency, mode):
    path = save(tmp_path, YAML + f"mode: {mode}\n")
    expected = read_map(path).data
    expected[1, 0] = -1
    gray = Image.open(tmp_path / "m.pgm")
    if transparency == "alpha":
        image = gray.convert("LA")
        image.putpixel((0, 0), (0, 254))
        image.save(tmp_path / "m.pgm", "png")
    else:
        gray.save(tmp_path / "m.pgm", "png", transparency=0)
    assert np.array_equal(read_map(path).data, expected)


def test_the_mode_scale_keeps_chances_between_the_thresholds(tmp_path):
    path = save(tmp_path, YAML + "mode: Scale\n")
    grid = read_map(path)
    # chance (c - 0.25) / (0.65 - 0.25) of the gray values 90 and 191
    assert grid.data.tolist() == [[0, 0, 0], [100, 100, 99]]
    assert filled_cells(grid).tolist() == [[False] * 3, [True, True, False]]


def test_the_mode_raw_takes_values_as_they_are(tmp_path):
    path = save(tmp_path, YAML + "mode: raw\n")
    grid = read_map(path)
    assert grid.data.tolist() == [[-1, -1, -1], [0, 89, 90]]
    assert filled_cells(grid).tolist() == [[True] * 3, [False] * 3]


@pytest.mark.parametrize(
    "line, value",
    {
        "negate: true": 1,
        "negate: off": 0,
        "negate: '1'": 1,
        "resolution: 1e-1": 0.1,
        "resolution: '0.1'": 0.1,
        "image: 2020-01-01": "2020-01-01",
        "image: no": "no",
        "mode: TRINARY": "trinary",
    }.items(),
)
def test_keys_are_read_as_yaml_cpp_reads_them(tmp_path, line, value):
    map_file = read_map_file(save(tmp_path, with_keys(line)))
    assert getattr(map_file, line.partition(":")[0]) == value


def test_keys_that_map_server_ignores_are_named_in_a_note(tmp_path, caplog):
    path = save(tmp_path, YAML + "name: hall\nfloor: 2\n")
    assert read_map(path).resolution == 0.1
    assert f"{path}: ignored keys, as in map_server: name, floor" in caplog.messages


def test_a_folder_of_maps_skips_what_is_no_map_of_obstacles(tmp_path, caplog):
    parameters = "/**:\n  ros__parameters: {a: 1}\n"
    texts = {
        "a": YAML,
        "._a": "\0",
        "b": YAML + "mode: Scale\n",
        "nav2_params": parameters,
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    assert open_dataset(tmp_path).world_numbers == (0,)
    assert "b.yaml, nav2_params.yaml" in caplog.messages[-1]
    # Where all maps are of such a mode, they are what is meant.
    (tmp_path / "a.yaml").unlink()
    assert open_dataset(tmp_path).world_numbers == (0,)


@pytest.mark.parametrize("historical", [False, True])
@given(npst.arrays(bool, st.tuples(st.integers(3, 10), st.integers(1, 10))))
def test_worlds_come_back_from_their_maps(historical, grid):
    grid[[0, -1]] = True
    grid[1] = False
    world = World("w", grid, np.array([[1, 0]]))
    occupancy = world.occupancy_map(historical=historical)
    assert np.array_equal(extract_grid(occupancy), grid)


def test_original_maps_give_the_original_grids(original_folder):
    worlds = open_dataset(original_folder)
    maps = open_dataset(original_folder / "map_files")
    assert maps.world_numbers == worlds.world_numbers
    assert all(
        maps.load(index).checksum == worlds.load(index).checksum
        for index in maps.world_numbers
    )


def test_any_other_map_is_taken_as_it_is_in_its_place(tmp_path):
    data = np.zeros((20, 30), np.int8)
    data[[0, -1]] = 100
    data[3, :4] = -1
    write_map(OccupancyMap(data, 0.15, 3.0, 4.0), tmp_path / "room.yaml")
    world = read_world(tmp_path / "room.yaml", STANDARD_ROBOT)
    assert np.array_equal(world.grid, data.T != 0)
    assert (world.corner_m, len(world.containment_m)) == ((3.0, 4.0), 0)
    assert world.bounds_m == pytest.approx((3.0, 4.0, 7.5, 7.0))


@pytest.mark.parametrize(
    "change, message",
    [
        (
            "image: none.pgm",
            "image: 'none.pgm' is not a file; put .*, or change image; did you mean 'm.pgm'",
        ),
        ("image: .", "image: '.' is not a file; put"),
        ("image: M.pgm", "did you mean 'm.pgm'"),
        (f"image: {'9' * 300}", "image: '999.*is not a file"),
        ("image: [m]", "image must be text"),
        (("image: m.pgm\n", ""), "missing key 'image'"),
        ("resolution: 0", "resolution must be from 0.005 to 10 m, got 0"),
        ("resolution: .nan", "resolution must be from 0.005 to 10 m, got nan"),
        ("resolution: fine", "resolution must be a number, got 'fine'"),
        ("origin: [1.0, -2.0]", "origin"),
        ("origin: [1.0, .inf, 0.0]", r"origin must be from -1e\+06 to 1e\+06, got inf"),
        (f"origin: [1.0, {'9' * 400}, 0]", "origin must be from .*, got inf"),
        ("resolution: 1:30", "must be a number, got '1:30'"),
        ("negate: maybe", "negate must be a whole number, got 'maybe'"),
        ("strat: [1, 1, 0]", "unknown key 'strat'; did you mean 'start'"),
        ("origin: [1.0, 2.0, 0.5]", "origin must have a yaw of 0"),
        ("routes: {a: {start: [0, 0, 0]}}", r"missing key 'routes\[a\].goal'"),
        (
            "routes: {a: {start: [0, 0, 0], goal: [1, 1], waypoints: [1]}}",
            r"routes\[a\].waypoints are not allowed, because a trial has one goal: write a",
        ),
        (
            "route: {a: {start: [0, 0, 0], goal: [1, 1]}}",
            "unknown key 'route'; did you mean 'routes'",
        ),
        (
            "start: [0, 0, 0]\ngoal: [1, 1]\nroutes: {a: {start: [0, 0, 0], goal: [1, 1]}}",
            "start must be inside one of routes",
        ),
        ("negate: 2", "negate must be from 0 to 1, got 2"),
        ("free_thresh: 0.7", "free_thresh must be at most occupied_thresh"),
        (
            "start: [0, 0, 0]\ngoal: [1, 2, 3, 4]",
            r"goal must be x and y, or x, y and yaw, got \(1\.0, 2\.0, 3\.0, 4\.0\)",
        ),
        (
            "mode: scales",
            "mode must be one of trinary, scale, raw, got 'scales'; did you mean 'scale'",
        ),
        ("mode: &a [b]\nmore: *a", r"not YAML: aliases \(\*name\) are not allowed"),
        ((YAML, "a: [1"), "not YAML"),
        ((YAML, "a: " + "x" * 70_000), "more than the allowed 65536 bytes"),
    ],
)
def test_malformed_descriptions_are_refused(tmp_path, change, message):
    text = with_keys(change) if isinstance(change, str) else YAML.replace(*change)
    with refused(message, WorldError):
        read_map(save(tmp_path, text))


def test_masks_in_a_folder_are_no_maps(tmp_path):
    # Nav2 names its masks of places to avoid so; their mode is trinary, too.
    files = [tmp_path / name for name in ("a.yaml", "a_keepout.yaml", "Mask.yaml")]
    for file in files:
        file.write_text(YAML)
    assert select_maps(files) == files[:1]


LEGS = """waypoints:
  waypoint0: {pose: [1.0, 2.0, 0.0], orientation: [1, 0, 0, 0]}
  waypoint1: {pose: [3.0, 2.0, 0.0], orientation: [0.5, 0, 0, 0.5]}
  waypoint2: {pose: [3.0, 5.0, 0.0], orientation: [0, 0, 0, 1]}
"""


def test_waypoints_saved_in_rviz_are_routes_from_each_to_the_next(tmp_path):
    path = save(tmp_path, YAML + "routes: legs.yaml\n")
    legs = tmp_path / "legs.yaml"
    legs.write_text(LEGS)
    names = ["waypoint0 to waypoint1", "waypoint1 to waypoint2"]
    assert read_route_names(path) == names
    routes = read_map_file(path).routes
    assert routes[names[0]].start == (1.0, 2.0, 0.0)
    assert routes[names[1]].start == pytest.approx((3.0, 2.0, np.pi / 2))
    assert routes[names[0]].goal == routes[names[1]].start

    with refused("is not a map; name it .*: routes: legs.yaml", WorldError):
        read_map_file(legs)
    for text, message in (
        ("{type: FeatureCollection, features: []}", "must have two waypoints or more"),
        (
            "building_name: a\nlevels: {}",
            "is a navigation graph of Open-RMF; must .*: routes: ",
        ),
        (LEGS.replace("[0, 0, 0, 1]", "[0, 0, 0, 0]"), "orientation must not be all 0"),
        (LEGS.replace("[0, 0, 0, 1]", "[0, 1]"), "waypoint2.*orientation must"),
    ):
        legs.write_text(text)
        assert read_route_names(path) == []
        with refused(message, WorldError):
            read_map_file(path)


FLOATING = io.BytesIO()
Image.new("F", (3, 2)).save(FLOATING, "TIFF")


@pytest.mark.parametrize(
    "pgm, message",
    [
        (b"", r"TGA, PCX\): cannot identify image file$"),
        (b"GIF89a" + bytes(20), "not a readable image"),
        (b"P5\n3 2\n255\n\0", "not a readable image"),
        (b"P5\n3 x\n255\n" + bytes(6), "image"),
        (b"P5\n-3 2\n255\n" + bytes(6), "image"),
        (b"P5\n0 0\n255\n", "image"),
        (b"P5\n5000 5000\n255\n" + bytes(10), "must have at most 16000000 pixels"),
        (b"P5\n100000 100000\n255\n" + bytes(10), "image"),
        (FLOATING.getvalue(), "pixels of mode F are not supported"),
    ],
)
def test_malformed_images_are_refused(tmp_path, pgm, message):
    with refused(f"{tmp_path / 'm.pgm'}.*{message}", WorldError):
        read_map(save(tmp_path, pgm=pgm))
