"""Gazebo world files: the originals exactly, our own there and back, and the malformed refused."""

import gzip
import math

import numpy as np
import pytest
from defusedxml import ElementTree
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.generate import TABLE_I, automaton_grids
from barn_worlds.formats.gazebo import GazeboFile, fill_hollow
from barn_worlds.formats.sdf import sdf_text, write_sdf
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.world import World

GRIDS = npst.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12)))


def model(
    name="m",
    pose="-0.225 5.325 0.5 0 0 0",
    radius="0.075",
    shape="cylinder",
    inside="",
    attribute="",
):
    size = f"<{shape}><radius>{radius}</radius><length>1</length></{shape}>"
    collision = f"<collision name='c'><geometry>{size}</geometry></collision>"
    return f"<model name='{name}'><pose{attribute}>{pose}</pose><link name='l'>{collision}</link>{inside}</model>"


def document(*parts):
    return f"<sdf version='1.6'><world name='default'>{''.join(parts)}</world></sdf>".encode()


def one_model(**changes):
    return document(model(**changes))


def grid_in(content):
    return GazeboFile(content, "a.world").grid()


def shown(grid):
    """Return the cells of a grid that a file shows."""
    return grid & ~geometry.hollow_cells(grid)


def test_grids_from_the_original_files_equal_the_original_grids(original_folder):
    files = sorted((original_folder / "world_files").iterdir())
    assert files
    for file in files:
        index = file.name.split("_")[1].split(".")[0]
        grid, resolution_m = GazeboFile.read(file).grid()
        assert resolution_m == 0.15
        expected = np.load(original_folder / "grid_files" / f"grid_{index}.npy")
        assert np.array_equal(grid, expected == 1), file.name


@given(GRIDS)
def test_filling_is_consistent_with_what_is_shown(grid):
    hull = shown(grid)
    filled = fill_hollow(hull)
    assert np.array_equal(shown(filled), hull)
    assert (filled >= grid).all()  # what was left out is always filled again


def test_filling_recovers_generated_worlds():
    for number, parameters in enumerate(TABLE_I):
        for k in range(20):
            generator = np.random.default_rng([number, k])
            *_, grid = automaton_grids(parameters, generator)
            assert np.array_equal(fill_hollow(shown(grid)), grid), (number, k)


def test_a_gap_whose_filling_would_hide_a_shown_cell_stays_empty():
    grid = np.zeros((7, 9), bool)
    grid[1:6, 1:8] = True
    grid[3, 4] = False  # its neighbors are shown because of it
    assert np.array_equal(fill_hollow(shown(grid)), grid)


@given(
    st.tuples(st.integers(3, 12), st.integers(2, 12)).flatmap(
        lambda shape: npst.arrays(bool, shape)
    ),
    st.sampled_from([0.05, 0.1, 0.15, 0.5]),
    st.sampled_from(["classic", "gz"]),
    st.booleans(),
    st.booleans(),
)
def test_worlds_come_back_from_our_files(
    tmp_path_factory, grid, resolution_m, flavour, movable, packed
):
    grid[[0, -1]] = True
    grid[1] = False
    path = [[1, column] for column in range(grid.shape[1])]
    world = World("<w & 'x'>", grid, np.array(path), resolution_m)
    file = tmp_path_factory.mktemp("sdf") / ("w.world.gz" if packed else "w.sdf")
    write_sdf(world, file, flavour, movable=movable)
    read, size = GazeboFile.read(file).grid()
    assert size == resolution_m
    assert np.array_equal(read, fill_hollow(shown(grid)))


def test_sdf_says_what_the_simulator_needs(small_world):
    classic = ElementTree.fromstring(sdf_text(small_world))
    assert classic.get("version") == "1.6"
    models = classic.findall("world/model")[1:]  # the first is the ground
    assert len(models) == len(small_world.cylinders_m)
    assert {entry.findtext("static") for entry in models} == {"true"}

    current = ElementTree.fromstring(sdf_text(small_world, "gz", movable=True))
    assert current.get("version") == "1.9"
    plugins = {plugin.get("name") for plugin in current.findall("world/plugin")}
    assert "gz::sim::systems::Physics" in plugins
    movable = [
        entry
        for entry in current.findall("world/model")
        if entry.findtext("static") == "false"
    ]
    assert len(movable) == len(small_world.obstacles_m)
    assert {entry.findtext("link/inertial/mass") for entry in movable} == {"1"}
    # a solid upright cylinder of 1 kg, radius 0.075 m, height 1 m
    inertia = movable[0].find("link/inertial/inertia")
    assert float(inertia.findtext("izz")) == pytest.approx(0.0028125)
    assert float(inertia.findtext("ixx")) == pytest.approx(0.0847396, abs=1e-6)
    heights = {float(entry.findtext("pose").split()[2]) for entry in movable}
    assert heights == {0.5}

    with refused("unknown SDF flavor 'clasic'; did you mean 'classic'", WorldError):
        sdf_text(small_world, "clasic")


def test_poses_of_model_link_and_collision_add_up():
    collision = (
        "<collision name='c'><pose>0 0.15 0 0 0 0</pose><geometry><cylinder><radius>0.075</radius></cylinder>"
        "</geometry></collision>"
    )
    link = f"<link name='l'><pose>0.075 0.075 0 0 0 0</pose>{collision}</link>"
    content = document(f"<model name='m'><pose>-1.5 5.1 0 0 -0 0</pose>{link}</model>")
    (center,) = GazeboFile(content, "w").cylinders[0]
    assert center == pytest.approx([-1.425, 5.325])


def centers_in(*parts):
    """Return x, y in m of the only cylinders in a document."""
    centers, _ = GazeboFile(document(*parts), "w").cylinders
    return centers.round(6).tolist()


# A model at (3, 4) m, turned by a quarter to the left, with a cylinder 1 m ahead.
TURNED = [3.0, 5.0]
CYLINDER = "<collision name='c'>{}<geometry><cylinder><radius>0.1</radius></cylinder></geometry></collision>"
LINK = f"<link name='l'><pose>1 0 0 0 0 0</pose>{CYLINDER.format('')}</link>"
HALL = "<frame name='hall'><pose>2 4 0 0 0 {}</pose></frame>"


@pytest.mark.parametrize(
    "parts",
    [
        [f"<model name='m'><pose>3 4 0 0 0 {math.pi / 2}</pose>{LINK}</model>"],
        [f"<model name='m'><pose degrees='true'>3 4 0 0 0 90</pose>{LINK}</model>"],
        [
            f"<model name='m'><pose rotation_format='quat_xyzw'>3 4 0 0 0 2 2</pose>{LINK}</model>"
        ],
        [
            HALL.format(math.pi / 2),
            f"<model name='m'><pose relative_to='hall'>0 -1 0 0 0 0</pose>{LINK}</model>",
        ],
        # SDF 1.6 called the attribute `frame`, and wrote it where it is empty, too.
        [
            HALL.format(0),
            f"<model name='m'><pose frame='hall'>1 0 0 0 0 {math.pi / 2}</pose>{LINK}</model>",
        ],
        # A frame without a pose of its own is where it is attached.
        [
            HALL.format(math.pi / 2),
            "<frame name='door' attached_to='hall'/>",
            f"<model name='m'><pose relative_to='door'>0 -1 0 0 0 0</pose>{LINK}</model>",
        ],
        # A frame in another model, and what a joint carries.
        [
            "<model name='n'><pose>3 0 0 0 0 0</pose><frame name='f'>"
            "<pose>0 4 0 0 0 1.570796327</pose></frame></model>",
            f"<model name='m'><pose relative_to='n::f'/>{LINK}</model>",
        ],
        [
            f"<model name='m'><pose>3 4 0 0 0 0</pose><link name='l'><pose relative_to='j'>0 1 0 0 0 0</pose>"
            f"{CYLINDER.format('')}</link><joint name='j'><child>k</child></joint><link name='k'/></model>"
        ],
        # The pose of the model is that of its frame, 2 m behind it.
        [
            "<model name='m' placement_frame='p'><frame name='p'><pose>-2 0 0 0 0 0</pose></frame>"
            f"<pose>3 2 0 0 0 1.570796327</pose>{LINK}</model>"
        ],
        [
            "<model name='o'><pose>3 4 0 0 0 1.570796327</pose><model name='m'>"
            f"<link name='k'/><frame name='f'/>{LINK}</model></model>"
        ],
        # The defaults written out, and a tilt as physics leaves it.
        [
            "<model name='m'><pose relative_to='world'>3 4 0 2e-6 -3e-6 1.570796327</pose><link name='l'>"
            "<pose relative_to='__model__'>1 0 0 0 0 0</pose>"
            + CYLINDER.format("<pose relative_to='l'>0 0 0 0 0 1</pose>")
            + "</link></model>"
        ],
    ],
)
def test_poses_follow_the_frames_of_sdf(parts):
    assert centers_in(*parts) == [TURNED]


def test_robots_drive_through_shapes_without_contact_bits():
    contact = "<surface><contact><collide_bitmask>0x00</collide_bitmask>{}</contact></surface>"
    no_bits = CYLINDER.format(contact.format(""))
    one_bit = CYLINDER.format(contact.format("<category_bitmask>1</category_bitmask>"))
    for collision, expected in ((no_bits, []), (one_bit, [[0.0, 0.0]])):
        link = f"<link name='k'>{collision}</link>"
        centers = centers_in(f"<model name='m'>{link}{LINK}</model>")
        assert centers == [*expected, [1.0, 0.0]]


def test_a_saved_world_is_as_gazebo_shows_it_after_loading():
    state = (
        "<state><insertions><model name='new'><pose>5 6 0 0 0 0</pose>{}</model></insertions>"
        "<deletions><name>gone</name></deletions><model name='m'><pose>1 2 0 0 0 0</pose><scale>2 3 1</scale>"
        "<link name='l'><pose>{} 4 0 0 0 0</pose></link></model></state><state><model name='m'>"
        "<pose>9 9 0 0 0 0</pose></model></state>"
    )
    gone = f"<model name='gone'>{LINK}</model>"
    moved = (
        f"<model name='m' placement_frame='none'><pose>7 7 0 0 0 0</pose>{LINK}</model>"
    )
    content = document(gone, moved, state.format(LINK, 3))
    centers, radii = GazeboFile(content, "w").cylinders
    assert centers.tolist() == [[3.0, 4.0], [6.0, 6.0]]
    assert radii == pytest.approx([0.3, 0.1])


def test_cylinders_that_a_saved_scale_puts_off_the_grid_are_refused_by_its_name():
    state = "<state><model name='m'><scale>2 2 1</scale></model></state>"
    model = f"<model name='m'><pose>-4.425 5.175 0.5 0 0 0</pose>{LINK}</model>"
    with refused("<state> scales model 'm' by 2: write <scale", WorldError):
        GazeboFile(document(model, state), "w").grid()


@pytest.mark.parametrize(
    "name",
    [
        "Sun",
        "Ground Plane/2",
        "Ground%20Plane/tip/files/model.sdf",
        "sun/",
        "ground_plane",
    ],
)
def test_what_no_world_is_without_is_known_from_fuel(name):
    uri = f"https://fuel.gazebosim.org/1.0/OpenRobotics/models/{name}"
    include = f"<include><uri>{uri}</uri></include>"
    assert centers_in(include, f"<model name='m'>{LINK}</model>") == [[1.0, 0.0]]


def test_start_and_goal_follow_their_frames():
    frames = (
        HALL.format(math.pi / 2)
        + "<frame name='start'><pose relative_to='hall'>1 0 0 0 0 0</pose></frame>"
        "<frame name='goal' attached_to='start'><pose>0 -1 0 0 0 0</pose></frame>"
    )
    course = GazeboFile(document(frames), "w").course()
    assert course == pytest.approx([2, 5, math.pi / 2, 3, 5, math.pi / 2])
    leaning = "<frame name='start'><pose>0 0 0 1 0 0</pose></frame>"
    with refused("frame 'start': leans by 1 rad", WorldError):
        GazeboFile(document(leaning), "w").course()


BOMB = (
    b'<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    b"<sdf><world>&b;</world></sdf>"
)
EXTERNAL = b'<!DOCTYPE x [<!ENTITY f SYSTEM "file:///etc/passwd">]><sdf><world>&f;</world></sdf>'


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", "not well-formed XML"),
        (b"<sdf><world>", "not well-formed XML"),
        (b"\xff\xfe\x00garbage", "not well-formed XML"),
        (b"<?xml version='1.0' encoding='none-such'?><sdf/>", "not well-formed XML"),
        (BOMB, "document types and entities are not allowed"),
        (EXTERNAL, "document types and entities are not allowed"),
        (b"<sdf><world/></sdf>", "contains no cylinders"),
        (
            b"<sdf version='2.0'><world/></sdf>",
            "version of <sdf> must be 1.x, got '2.0'",
        ),
        (
            b"<gazebo><world/></gazebo>",
            "must be <sdf> with one <world>, got <gazebo> with 1",
        ),
        (
            one_model(pose="1 2 3"),
            "model 'm': pose must be 6 finite numbers, got '1 2 3'",
        ),
        (
            one_model().replace(
                b"<geometry>",
                b"<surface><contact><collide_without_contact>1</collide_without_contact>"
                b"</contact></surface><geometry>",
            ),
            "model 'm': collide_without_contact must be false, got '1': ",
        ),
        (one_model(pose="nan 0 0 0 0 0"), "pose must be 6 finite numbers"),
        (one_model(pose="x 0 0 0 0 0"), "pose must be 6 finite numbers"),
        (one_model(pose="1_0 0 0 0 0 0"), "pose must be 6 finite numbers"),
        (one_model(pose="1e300 0 0 0 0 0"), "pose must be 6 finite numbers"),
        (one_model(pose="-0.2 5.3 0 1.57 0 0"), "model 'm': leans by 1.57 rad"),
        (one_model(pose="-0.2 5.3 1 0 0 0"), "from 0.5 to 1.5 m above"),
        (one_model(pose="-0.2 5.3 -1 0 0 0"), "does not extend through 0.1 m"),
        (one_model(attribute=" relative_to='mm'"), "no frame 'mm'; did you mean 'm'"),
        (one_model(attribute=" relative_to='m'"), "frame 'm' is relative to itself"),
        (
            one_model(attribute=" rotation_format='quat'"),
            "unknown rotation_format 'quat'; did you mean 'quat_xyzw'",
        ),
        (
            one_model(attribute=" rotation_format='quat_xyzw'"),
            "pose must be 7 finite numbers",
        ),
        (
            document(
                model(pose="0 0 0 0 0 0 0", attribute=" rotation_format='quat_xyzw'")
            ),
            "quaternion of length 0",
        ),
        (
            one_model(attribute=" rotation_format='quat_xyzw' degrees='true'"),
            "must not have both degrees and quat_xyzw",
        ),
        (b"<sdf><world/><world/></sdf>", "got <sdf> with 2"),
        (
            document(
                *(f"<frame name='f{k}' attached_to='f{k + 1}'/>" for k in range(2000)),
                model(attribute=" relative_to='f0'"),
            ),
            "frames nested too deeply",
        ),
        (
            document("<model name='m'>" * 2000 + "</model>" * 2000),
            "models are nested too deep",
        ),
        (one_model(radius=""), "radius must be a finite number, got ''"),
        (one_model(radius="-1"), "radius and length must be above 0"),
        (
            one_model(radius="0.001"),
            "radius of a cylinder must be from 0.005 to 5 m, got 0.001",
        ),
        (one_model(shape="box"), "shape must be one cylinder, got box"),
        (
            one_model(inside="<include><uri>model://sun</uri></include>"),
            "<include> inside a model",
        ),
        (
            document("<include><uri>model://house</uri></include>"),
            "included model 'model://house' is unknown",
        ),
        (document("<actor name='a'/>"), "<actor> cannot be part"),
        (document(model(), model()), "model 'm' has the name of another element"),
        (one_model(inside="<frame name='l'/>"), "model 'm': frame 'l' has the"),
        (
            document(model(), model("n", radius="0.08")),
            "must have the same radius, got 0.075 m and 0.08 m",
        ),
        (
            one_model(pose="-0.2 5.325 0 0 0 0"),
            r"cylinder at \[-0.2, 5.325\] m is not on the grid of 0.15 m",
        ),
        (
            document(model(), model("n", pose="0.075 5.325 0 0 0 0")),
            r"\[0.075, 5.325\] m is not on the grid",
        ),
        (one_model(pose="-0.225 5.4 0 0 0 0"), "is not on the grid"),
        (one_model(pose="-99999 5.325 0 0 0 0"), "is too far out"),
        (document(model(), model("n", pose="-0.225 99999 0 0 0 0")), "is too far out"),
        (
            document(
                model("n", "-0.375 5.325 0 0 0 0"), model(pose="-0.225 3.075 0 0 0 0")
            ),
            r"stands at \[-0.225, 3.075\] m, in front of the field",
        ),
        (
            document(model(), model("n", pose="-0.075 0.075 0 0 0 0")),
            "of the containment is missing at",
        ),
    ],
)
def test_malformed_files_are_refused_in_one_line(content, message):
    with refused(f"^a.world: .*{message}", WorldError):
        grid_in(content)


def test_a_file_of_nothing_but_containment_has_no_field(small_world):
    bare = World("bare", np.zeros((9, 12), bool), small_world.path)
    with refused("no cylinders beyond the containment", WorldError):
        grid_in(sdf_text(bare).encode())


def test_the_containment_may_be_missing_as_a_whole():
    grid, _ = grid_in(document(model(), "<include><uri>model://sun</uri></include>"))
    assert grid.tolist() == [[False, True], [False, False]]


def test_sizes_are_bounded(tmp_path, monkeypatch):
    bomb = tmp_path / "bomb.world.gz"
    monkeypatch.setattr("barn_worlds.formats.gazebo.LARGEST_WORLD_FILE", 1_000_000)
    bomb.write_bytes(gzip.compress(b" " * 2_000_000))
    with refused("unpacks to more than", WorldError):
        GazeboFile.read(bomb)
    monkeypatch.setattr("barn_worlds.formats.gazebo.MOST_TAGS", 1000)
    with refused("more than 1000 tags", WorldError):
        grid_in(document("<a/>" * 1000))
