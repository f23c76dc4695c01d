"""What is fuzzed: each reader of files of strangers, with seeds and mutations.

The seeds are made from real files.
"""

import base64
import io
import json
import random
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fuzz_mutator import mutate_bytes, mutate_plain
from mcap.writer import CompressionType, Writer
from PIL import Image
from rosbags import rosbag2

from barn_eval.analysis.sources import read_source
from barn_eval.analysis.tables import trials_table
from barn_eval.pages.replay.page import describe, list_facts
from barn_eval.pages.replay.payload import make_payload
from barn_eval.pages.template import script_json
from barn_eval.results.bags.decode import TOPICS
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.commands import commands_line, parse_commands_line
from barn_eval.results.folder import ResultsFolder
from barn_eval.results.rows import (
    RowFile,
    TrialLines,
    results_table,
    seal_line,
    timing_table,
    unseal_line,
)
from barn_eval.results.run_file import RunFile
from barn_eval.results.store import TrialRecord
from barn_eval.results.tracks import parse_track_line, track_line
from barn_eval.running.request import read_request
from barn_eval.trials.protocol import CHALLENGE, load_protocol
from barn_eval.trials.result import Outcome, Verdict, from_json_line, to_json_line
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.trajectory import Trajectory
from barn_eval.trials.trial import finish_trial
from barn_metrics.model import load_model
from barn_metrics.model.inputs import STRIPS, summary_names
from barn_metrics.model.predictor import DifficultyModel, RouteNetwork
from barn_metrics.model.route import CHANNELS
from barn_metrics.model.weights import save_model
from barn_planners.policy.file import Policy, PolicyNetwork, read_policy, write_policy
from barn_planners.policy.space import PolicyAction, PolicyObservation
from barn_sim.body.model import description_text
from barn_sim.config import SimulatorConfig, with_robot
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import read_lines
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.formats.map_server import extract_grid, read_map, write_map
from barn_worlds.formats.sdf import sdf_text, write_sdf
from barn_worlds.formats.single import read_world
from barn_worlds.formats.world_yaml import world_yaml
from barn_worlds.messages.cdr import jazzy_types, make_message, serialize
from barn_worlds.messages.topics import GROUND_TRUTH, ODOM
from barn_worlds.robots.files import find_robot_files, load_robot
from barn_worlds.robots.urdf import read_chassis

Mutate = Callable[[random.Random, bytes, Sequence[bytes]], bytes]


@dataclass(frozen=True)
class Reader:
    """A reader under test.

    name: of the file in a folder of its own. seeds: contents of good files; whatever
    else `read` needs is put into the folder given. read: reads the file and uses what
    it got as the suite does; a BarnError is a refusal.
    """

    name: str
    seeds: Callable[[Path], list[bytes]]
    read: Callable[[Path], Any]
    mutate: Mutate = mutate_bytes


def _json(draw: random.Random, data: bytes, donors: Sequence[bytes]) -> bytes:
    """Change a JSON document as bytes, or as the data that it stands for."""
    if draw.random() < 0.4:
        return mutate_bytes(draw, data, donors)
    try:
        content = mutate_plain(draw, json.loads(data))
        return json.dumps(content, ensure_ascii=draw.random() < 0.8).encode(
            "utf-8", "surrogatepass"
        )
    except (ValueError, RecursionError):
        return mutate_bytes(draw, data, donors)


def _lines(draw: random.Random, data: bytes, donors: Sequence[bytes]) -> bytes:
    """Change a line of JSON, now and then with the right checksum, or the file."""
    lines = data.splitlines()
    if draw.random() < 0.2 or not lines:
        return mutate_bytes(draw, data, donors)
    number = draw.randrange(len(lines))
    try:
        line = unseal_line(lines[number].decode(), "")
        content = (
            _change_unpacked(draw, json.loads(line)) if draw.random() < 0.3 else None
        )
        changed = (
            json.dumps(content).encode()
            if content
            else _json(draw, line.encode(), donors)
        )
        if draw.random() < 0.5:
            changed = seal_line(changed.decode()).encode()
        lines[number] = changed
    except (ValueError, ConfigError):
        return mutate_bytes(draw, data, donors)
    return b"\n".join(lines) + b"\n"


def _change_unpacked(draw: random.Random, content: Any) -> Any:
    """Change what a track has packed."""
    if isinstance(content, dict) and isinstance(content.get("zlib"), str):
        packed = mutate_bytes(
            draw, zlib.decompress(base64.b64decode(content["zlib"])), [b"\xff" * 100]
        )
        content["zlib"] = base64.b64encode(zlib.compress(packed, 1)).decode()
        return content
    return None


def _npz(draw: random.Random, data: bytes, donors: Sequence[bytes]) -> bytes:
    """Change a member of an archive, or the archive."""
    if draw.random() < 0.3:
        return mutate_bytes(draw, data, donors)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # a member of the corpus need not be an archive
        return mutate_bytes(draw, data, donors)
    name = draw.choice(list(members))
    if name.endswith(".json"):
        members[name] = _json(draw, members[name], [members[name]])
    else:
        head = members[name][:128]
        rest = members[name][128:]
        if draw.random() < 0.7:
            members[name] = mutate_bytes(draw, head, [head]) + rest
        else:
            members[name] = mutate_bytes(draw, members[name], [head])
    if draw.random() < 0.05:
        del members[name]
    file = io.BytesIO()
    with zipfile.ZipFile(
        file, "w", draw.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    ) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def _files(*paths: Path) -> list[bytes]:
    return [path.read_bytes() for path in paths]


def _world() -> Any:
    return open_dataset("barn_test").load(open_dataset("barn_test").world_numbers[0])


def _scene() -> Any:
    """Return a world with walls and two moving obstacles."""
    arena = open_dataset("dynabarn60").load(0)
    return replace(arena, moving=arena.moving[:2])


def _experiment(folder: Path) -> Path:
    """Make a folder of an experiment in which every trial timed out, with tracks."""
    config = RunConfig(
        worlds="0,9", planners=(PlannerChoice("gap"), PlannerChoice("dwa"))
    )
    specs = config.trials()
    out = folder / "experiment"
    with ResultsFolder.open(out, config, ExecutionConfig(), specs) as results:
        for spec in specs:
            steps = np.linspace(0.0, 2.0, 40)
            driven = Trajectory(
                np.arange(40) * 50_000_000,
                np.column_stack([steps, steps, 0.0 * steps]),
                np.full((40, 2), 0.5),
                np.full((40, 2), 0.5),
                np.zeros(40, bool),
                np.full(40, np.nan),
                np.ones(40, np.int64),
            )
            finished = finish_trial(
                spec, "direct", Verdict(Outcome.TIMEOUT, "", 100.0, 100.0, 0.0), driven
            )
            record = TrialRecord(
                finished.result, track_line(finished), commands_line(finished)
            )
            results.append(record)
        results.complete()
    return out


def _beside(folder: Path, name: str) -> list[bytes]:
    """Return a file of an experiment and put the others beside the files under test."""
    out = _experiment(folder)
    for path in out.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return _files(out / name)


def _rows(path: Path) -> None:
    results = RowFile(path.parent).read()
    results_table(results), timing_table(results), trials_table(results, "").csv()
    for result in results:
        assert from_json_line(to_json_line(result), "") == result
        result.trial_id.encode()


def _tracks(path: Path) -> None:
    for line in TrialLines(path).values():
        assert parse_track_line(line, "")[1].packed


def _commands(path: Path) -> None:
    for where, line in read_lines(path):
        parse_commands_line(unseal_line(line, where), where)


def _run(path: Path) -> None:
    RunFile.read(path.parent).run_config()
    assert read_source(path.parent).results


def _request(path: Path) -> None:
    config = read_request(path, {}).config
    for planner in config.planners:
        config.resolve_planner(planner)


def _protocol(path: Path) -> None:
    assert load_protocol(str(path)).course(_world())


_REQUESTS = (
    b"""schema_version: 1
dataset: barn300
worlds: 0:300:50
planners: [dwa:challenge, {name: gap, overrides: {max_speed_mps: 1.0}}]
repetitions: 3
protocol: paper2020
simulator: {lidar.beams: 100}
seed: 7
execution: {workers: 2}
out: out/x
""",
    b"""schema_version: 1
mode: ros
planner_command: mine=python3 x.py
ros: {lockstep: false}
workers: 1
out: y
""",
)


def _protocol_seeds(_: Path) -> list[bytes]:
    protocol = {"schema_version": 1} | as_dict(CHALLENGE) | {"name": "mine"}
    whole = yaml.safe_dump(protocol).encode()
    return [
        b"schema_version: 1\nbase: challenge\nname: slow\nlimit_s: 200.0\nstart: {x_m: 1.0}\n",
        whole,
    ]


def _robot_seeds(folder: Path, ending: str) -> list[bytes]:
    jackal = find_robot_files()["jackal"]
    (folder / "jackal.urdf").write_bytes(jackal.with_suffix(".urdf").read_bytes())
    return [path.read_bytes() for path in sorted(jackal.parent.glob(f"*{ending}"))]


def _robot(path: Path) -> None:
    description_text(with_robot(SimulatorConfig(), load_robot(path)).chassis)


def _bag_seeds(_: Path) -> list[bytes]:
    seeds = []
    for part, compression in enumerate(
        (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)
    ):
        file = io.BytesIO()
        writer: Any = Writer(
            file,
            compression=compression,
            chunk_size=4096,
            enable_crcs=compression != CompressionType.NONE,
        )
        writer.start("ros2")
        for number, (topic, kinds) in enumerate(
            TOPICS.items()
        ):  # each bag has the poses, and a third of the others
            if number % 3 != part and topic not in (ODOM.path, GROUND_TRUTH.path):
                continue
            kind = sorted(kinds)[0]
            schema = writer.register_schema(kind, "ros2msg", b"")
            channel = writer.register_channel(topic, "cdr", schema)
            for time in range(2):
                data = serialize(_message(kind, time))
                writer.add_message(channel, time * 10**8, data, time * 10**8)
        writer.add_metadata(
            "barn.trial",
            {"specification": '{"planner": {"name": "dwa"}, "world": {"name": "w"}}'},
        )
        writer.add_metadata(
            "barn.result",
            {"result": '{"outcome": "success", "scores": {"challenge": 0.5}}'},
        )
        writer.finish()
        seeds.append(file.getvalue())
    return seeds


def _message(kind: str, time: int) -> Any:
    """Return a message of a type that a replay shows something of."""
    if kind == "sensor_msgs/msg/LaserScan":
        return make_message(
            kind,
            ranges=np.full(20, 2.0, np.float32),
            angle_increment=0.1,
            range_max=30.0,
        )
    if kind == "nav_msgs/msg/OccupancyGrid":
        info = make_message(
            "nav_msgs/msg/MapMetaData", width=4, height=3, resolution=0.15
        )
        return make_message(kind, info=info, data=np.zeros(12, np.int8))
    if kind == "nav_msgs/msg/Path":
        return make_message(
            kind, poses=[make_message("geometry_msgs/msg/PoseStamped")] * 3
        )
    if kind == "visualization_msgs/msg/MarkerArray":
        point = make_message("geometry_msgs/msg/Point", x=0.1 * time)
        points = [point] * 3
        marker = make_message("visualization_msgs/msg/Marker", type=4, points=points)
        return make_message(kind, markers=[marker])
    if kind == "tf2_msgs/msg/TFMessage":
        transform_type = "geometry_msgs/msg/TransformStamped"
        transform = make_message(transform_type, child_frame_id="laser")
        return make_message(kind, transforms=[transform])
    message = make_message(kind)
    if kind == "nav_msgs/msg/Odometry":
        message.pose.pose.orientation.w = 1.0
    return message


def _bag(path: Path) -> None:
    recorded_trial = read_recorded_trial(
        path if path.suffix == ".mcap" else path.parent
    )
    (
        script_json(make_payload(recorded_trial)),
        list_facts(recorded_trial),
        describe(recorded_trial).encode(),
    )


def _sqlite_seeds(folder: Path) -> list[bytes]:
    with rosbag2.Writer(
        folder / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3
    ) as writer:
        for topic, kinds in list(TOPICS.items())[
            ::6
        ]:  # the reader takes most of its time for their description
            kind = sorted(kinds)[0]
            connection = writer.add_connection(topic, kind, typestore=jazzy_types())
            for time in range(2):
                writer.write(connection, time, serialize(_message(kind, time)))
    text = (folder / "bag" / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace("bag.db3", "input.db3"))
    return _files(folder / "bag" / "bag.db3")


def _npy_seeds(folder: Path) -> list[bytes]:
    for kind in (np.int64, np.float64, np.bool_, np.uint8):
        grid = _world().grid[:10, :10].astype(kind)
        np.save(folder / f"{kind.__name__}.npy", grid)
    return _files(*folder.glob("*.npy"))


def _dataset_seeds(folder: Path) -> list[bytes]:
    write_dataset_file(folder / "own.npz", "own", {0: _world(), 3: _world()})
    write_dataset_file(folder / "scenes.npz", "scenes", {0: _scene(), 7: _world()})
    return _files(folder / "own.npz", folder / "scenes.npz")


def _dataset(path: Path) -> None:
    dataset = open_dataset(path)
    assert [dataset.load(index).name.encode() for index in dataset.world_numbers[:3]]


def _single(path: Path) -> None:
    assert read_world(path, load_robot("jackal"))


def _gazebo_seeds(folder: Path) -> list[bytes]:
    whole = _world()
    thin = whole.grid & (np.indices(whole.grid.shape).sum(axis=0) % 10 == 0)
    world = replace(
        whole, grid=thin, corner_m=(-4.5, 5.1)
    )  # an arena, without the many cylinders of a containment
    write_sdf(world, folder / "w.world.gz")
    return [
        *(sdf_text(world, flavour).encode() for flavour in ("classic", "gz")),
        *_files(folder / "w.world.gz"),
    ]


def _map_seeds(folder: Path) -> list[bytes]:
    write_map(_world().occupancy_map(), folder / "map")
    (seed,) = _files(folder / "map.yaml")
    routes = b"routes: {a: {start: [-2, 6, 1], goal: [-2, 8]}, b: {start: [-2, 8, 0], goal: [-3, 6, 1]}}\n"
    return [seed, seed + routes]


def _map(path: Path) -> None:
    dataset = open_dataset(path)
    for number in dataset.world_numbers[:3]:
        assert dataset.load(number)


def _image_seeds(folder: Path) -> list[bytes]:
    text = _map_seeds(folder)[0].replace(b"map.pgm", b"input.pgm")
    (folder / "map.yaml").write_bytes(text)
    files = [folder / "map.pgm"]
    for ending in ("png", "bmp", "ppm"):
        for mode in ("L", "RGB", "1"):
            files.append(folder / f"{mode}.{ending}")
            image = Image.open(folder / "map.pgm").resize((20, 30))
            image.convert(mode).save(files[-1])
    return _files(*files)


def _image(path: Path) -> None:
    extract_grid(read_map(path.with_name("map.yaml")))


def _policy(path: Path) -> None:
    policy = read_policy(path)
    PolicyNetwork(policy).act(np.zeros(policy.layers[0], np.float32))


def _policy_seeds(folder: Path) -> list[bytes]:
    weights = tuple(np.ones(size, np.float32) for size in ((11, 4), (4, 2)))
    biases = tuple(np.zeros(size, np.float32) for size in (4, 2))
    write_policy(
        folder / "own.npz",
        Policy(PolicyObservation(beams=6), PolicyAction(), weights, biases),
    )
    return _files(folder / "own.npz")


def _weights_seeds(folder: Path) -> list[bytes]:
    size = len(summary_names())
    filters = tuple(
        (np.ones((1, first, 2)), np.zeros(2))
        for first in (len(STRIPS) * CHANNELS, 2, 2)
    )
    layers = ((np.ones((4 + size, 2)), np.zeros(2)),)
    network = RouteNetwork(np.zeros(size), np.ones(size), filters, layers)
    save_model(DifficultyModel(("dwa",), (network,), 0.1, {}), folder / "own.npz")
    return _files(folder / "own.npz")


READERS = {
    "rows": Reader(
        "results.jsonl", lambda folder: _beside(folder, "results.jsonl"), _rows, _lines
    ),
    "tracks": Reader(
        "tracks.jsonl", lambda folder: _beside(folder, "tracks.jsonl"), _tracks, _lines
    ),
    "commands": Reader(
        "commands.jsonl",
        lambda folder: _beside(folder, "commands.jsonl"),
        _commands,
        _lines,
    ),
    "run": Reader("run.json", lambda folder: _beside(folder, "run.json"), _run, _json),
    "campaign": Reader("input.yaml", lambda _: list(_REQUESTS), _request),
    "protocol": Reader("input.yaml", _protocol_seeds, _protocol),
    "robot": Reader("input.yaml", lambda folder: _robot_seeds(folder, ".yaml"), _robot),
    "urdf": Reader(
        "input.urdf", lambda folder: _robot_seeds(folder, ".urdf"), read_chassis
    ),
    "npy": Reader("input.npy", _npy_seeds, _single),
    "dataset": Reader("input.npz", _dataset_seeds, _dataset, _npz),
    "policy": Reader("input.npz", _policy_seeds, _policy, _npz),
    "weights": Reader("input.npz", _weights_seeds, load_model, _npz),
    "scene": Reader(
        "input.world.yaml", lambda _: [world_yaml(_scene()).encode()], _dataset
    ),
    "world": Reader("input.world", _gazebo_seeds, _single),
    "map": Reader("input.yaml", _map_seeds, _map),
    "image": Reader("input.pgm", _image_seeds, _image),
    "bag": Reader("input.mcap", _bag_seeds, _bag),
    "sqlite": Reader("input.db3", _sqlite_seeds, _bag),
}
