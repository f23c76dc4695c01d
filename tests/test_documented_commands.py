"""What the documentation names exists.

Commands with their options (parsed, not run), links, paths, Python names.
"""

import ast
import inspect
import re
import shlex
import textwrap
from functools import cache
from pkgutil import resolve_name

import click
import pytest
import yaml
from launch_files import launch_arguments
from repository import ROOT
from waiting import run_python, with_search_path

import barn_eval
from barn_eval.commands.main import COMMANDS, MORE, cli
from barn_eval.commands.options import parse_parameters
from barn_eval.trials.protocol import CHALLENGE, PROTOCOLS, load_protocol
from barn_eval.trials.result import Outcome
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.spec import simulator_config
from barn_planners.registry import planner_names
from barn_worlds.base.config import replace_dotted

PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "barn_*/README.md", "examples/**/*.md")
    for path in ROOT.glob(pattern)
)
# What a planner of one's own is called on these pages.
PLANNERS = """
mine simple template vector_pursuit nav2_dwb nav2_mppi nav2_rpp nav2_rpp_lockstep
gap_predictive mppi_predictive
"""


def commands(program):
    """Yield each command of a program that the pages show, as (page, words)."""
    for path in PAGES:
        text = re.sub(r"\\\n\s*", " ", path.read_text("utf-8"))
        lines = re.findall(r"(?m)^    (\S.*)$", text) + re.findall(r"`([^`\n]+)`", text)
        for block in re.findall(r"(?ms)^```(?:bash|sh|console)?\n(.*?)^```", text):
            lines += block.splitlines()
        for line in lines:
            for part in re.split(r" && | & | \| ", line):
                assignments = re.match(r"(?:[A-Z_]+=\S+ )*", part).end()
                if part[assignments:].startswith(program + " "):
                    command = part[assignments:]
                    name = f"{path.relative_to(ROOT)}: {command[:70]}"
                    yield pytest.param(command, id=name)


def words_of(line):
    return shlex.split(line, comments=True)


@pytest.mark.parametrize(
    "line", [*commands("barn"), *(example for example, _ in MORE.values())]
)
def test_barn_takes_what_is_shown(line):
    words = words_of(line)[1:]
    command = cli
    name = "barn"
    while isinstance(command, click.Group):
        if words in ([], ["--help"], ["--version"]):
            return
        name, *words = words
        command = command.get_command(click.Context(command), name)
        assert command is not None, name
    context = click.Context(command, info_name=name)
    values, _, _ = command.make_parser(context).parse_args(list(words))
    for parameter in command.params:
        value = values.get(parameter.name)
        if isinstance(value, str) and isinstance(
            parameter.type, (click.Choice, click.IntRange, click.FloatRange)
        ):
            parameter.type.convert(value, parameter, context)
    check_values(name, values)


def test_the_help_of_each_command_names_a_page():
    assert MORE.keys() == COMMANDS.keys()
    assert all((ROOT / page).is_file() for _, page in MORE.values())


def check_values(name, values):
    """Check what only the command itself would: protocol, settings and planners."""
    protocol = values.get("protocol") or CHALLENGE.name
    if protocol.startswith("examples/"):
        rules = load_protocol(str(ROOT / protocol))
    elif protocol.endswith(".yaml"):
        rules = CHALLENGE
    else:
        rules = PROTOCOLS[protocol]
    if name in ("run", "campaign"):
        settings = values.get("ros") or []
        shown = tuple(setting for setting in settings if "KEY" not in setting)
        replace_dotted(RosConfig(), parse_parameters(shown, "--ros"), "--ros")
        assignments = tuple(values.get("simulator") or ())
        simulator_config(rules, parse_parameters(assignments, "--sim"))
    names = {*planner_names(), *PLANNERS.split()}
    for planner in (values.get("planners") or "dwa").split(","):
        assert planner.rpartition("=")[2].split(":")[0] in names


@cache
def executables(package):
    """Return the programs that a package installs for `ros2 run`."""
    setup = (ROOT / package / "setup.cfg").read_text("utf-8")
    return set(re.findall(r"(?m)^    (\w+) = [\w.]+:\w+$", setup))


FOREIGN = [
    "my_nav",
    "my_robot",
    "my_planner",
    "template_planner",
    "template_planner_cpp",
]


@pytest.mark.parametrize("line", list(commands("ros2")))
def test_ros2_is_shown_with_what_exists(line):
    _, verb, *words = words_of(line)
    verbs = "run launch bag topic param node service action lifecycle pkg"
    assert verb in verbs.split()
    if verb == "run" and words and words[0] not in FOREIGN:
        package, program, *rest = words
        assert program in executables(package)
        if "--params-file" in rest:
            file = rest[rest.index("--params-file") + 1]
            assert (ROOT / package / file).is_file()
    if verb == "launch" and words and words[0] not in FOREIGN:
        launched = ROOT / words[0]
        arguments = words[1:]
        if not words[0].endswith(".launch.py"):
            launched = ROOT / words[0] / "launch" / words[1]
            arguments = words[2:]
        assert launched.is_file()
        declared = launch_arguments(launched)
        for argument in arguments:
            assert argument.partition(":=")[0] in declared, argument


@pytest.mark.parametrize(
    "line",
    [*commands("make"), *commands("docker"), *commands("python"), *commands("python3")],
)
def test_files_and_targets_that_are_shown_exist(line):
    words = words_of(line)
    if words[0] == "make":
        targets = set(
            re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"))
        )
        assert words[1] in targets
    for word in words[1:]:
        if word.startswith(("docker/", "examples/")):
            assert (ROOT / word).exists()
    if words[:2] == ["docker", "compose"]:
        file = words[words.index("-f") + 1]
        services = yaml.safe_load((ROOT / file).read_text("utf-8"))["services"]
        if "run" in words:
            (name,) = services.keys() & words
            # A container cannot join the network of one that has ended.
            assert "network_mode" not in services[name]


each_page = pytest.mark.parametrize(
    "path", PAGES, ids=lambda path: str(path.relative_to(ROOT))
)


@each_page
def test_links_lead_to_files_and_headings_that_exist(path):
    text = re.sub(r"(?ms)^```.*?^```", "", path.read_text("utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+://", target):
            continue
        file, _, heading = target.partition("#")
        linked_file = (path.parent / file).resolve() if file else path
        assert linked_file.exists(), target
        if heading:
            headings = re.findall(r"(?m)^#+ (.+)$", linked_file.read_text("utf-8"))
            anchors = {
                re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
                for title in headings
            }
            assert heading in anchors, target


def quotations(path):
    """Return the texts between backticks on a page.

    Code blocks and the changelog's past are left out.
    """
    text = path.read_text("utf-8")
    if path.name == "CHANGELOG.md":
        text = text.partition("\n## [Unreleased]")[2].partition("\n## [")[0]
    text = re.sub(r"(?ms)^```.*?^```", "", text)
    return sorted(set(re.findall(r"`([^`\n]+)`", text)))


PYTHON_NAME = re.compile(r"barn_(?:worlds|sim|planners|metrics|eval)(?:\.\w+)+(?=\(|$)")
TOP_FOLDER = re.compile(
    r"(?:barn_\w+|docs|docker|examples|qa|tests|\.ci|\.github)/[\w./*-]+$"
)
ENTRY_POINTS = {
    "barn_planners.planners"
}  # a group of entry points, named like a module


@each_page
def test_python_names_exist(path):
    matches = [
        PYTHON_NAME.match(text)
        for text in quotations(path)
        if not TOP_FOLDER.match(text)
    ]
    names = {match[0] for match in matches if match} - ENTRY_POINTS
    missing = [name for name in names if not exists(name)]
    assert missing == []


def exists(name):
    try:
        resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def test_everything_in_the_api_pages_exists():
    count = 0
    for path in (ROOT / "docs" / "api").glob("*.md"):
        for module, members in re.findall(
            r"(?m)^::: (\S+)(?:\n    options: .*members: \[(.*?)\])?",
            path.read_text("utf-8"),
        ):
            for name in ["", *filter(None, members.split(", "))]:
                resolve_name(f"{module}:{name}" if name else module)
                count += 1
    assert count > 50


@each_page
def test_paths_exist(path):
    named = [
        text.replace("NAME", "*") for text in quotations(path) if TOP_FOLDER.match(text)
    ]
    for text in named:
        assert [*ROOT.glob(text), *path.parent.glob(text)], text


@cache
def source_texts():
    """Return all texts in the source of the suite.

    Those between the values of an f-string are separate.
    """
    return [
        node.value
        for path in ROOT.glob("barn_*/barn_*/**/*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]


def symptoms():
    """Return what the first columns of troubleshooting's tables quote."""
    text = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    cells = re.findall(r"(?m)^\| ([^|]+) \|", text)
    return sorted(
        {quotation for cell in cells for quotation in re.findall(r"`([^`]+)`", cell)}
        - {"pip install", "/tf"}
    )


@pytest.mark.parametrize("symptom", symptoms())
def test_what_troubleshooting_quotes_is_what_the_suite_says(symptom):
    parts = [part.strip(" ,:") for part in re.split(r"…|; |: |, ", symptom)]
    for part in filter(lambda words: len(words) > 3, parts):
        assert any(part in text for text in source_texts()), part


def test_every_failure_is_in_troubleshooting():
    text = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    failures = [outcome for outcome in Outcome if outcome is not Outcome.SUCCESS]
    for outcome in failures:
        assert f"`{outcome.value}`" in text


def test_there_is_something_to_check():
    assert len(PAGES) > 15
    assert len(list(commands("barn"))) > 60
    assert len(list(commands("ros2"))) > 10


# With what examples are tried instead, so that they do not take long: fewer worlds and
# processes.
FEWER = {
    '"0:300:100"': '"0,100"',
    '"0:300:150"': '"0"',
    '"0:300:60"': '"0"',
    "per_set=3": "per_set=1",
    'predict("barn300")': 'predict("barn_test")',
    "per_class=50": "per_class=5",
    "workers=2": "workers=1",
}


def python_examples():
    """Yield the Python of each page and of each docstring of the front door.

    The blocks of a page come one after the other.
    """
    for path in PAGES:
        text = path.read_text("utf-8")
        blocks = re.findall(r"(?ms)^```python\n(.*?)^```", text)
        shown = "\n".join(blocks)
        runs = re.findall(r"(?m)^    (barn run .*)$", text)
        before = runs[:1] if "out/bag/" in shown else []
        if blocks:
            yield pytest.param(before, shown, id=str(path.relative_to(ROOT)))
    members = {"": barn_eval}
    for noun in dir(barn_eval):
        members[noun] = getattr(barn_eval, noun)
        if inspect.ismodule(members[noun]):
            functions = inspect.getmembers(members[noun], inspect.isfunction)
            members |= {f"{noun}.{name}": function for name, function in functions}
    for name, member in members.items():
        text = inspect.getdoc(member) or ""
        lines = re.search(
            r"(?m)^    (?:import |def |barn\.|\w+ = ).*(?:\n(?:    .*)?)*", text
        )
        if lines:
            yield pytest.param(
                [],
                "import barn_eval as barn\n\n" + textwrap.dedent(lines[0]),
                id=f"barn_eval.{name}".strip("."),
            )


@pytest.mark.parametrize("before, example", list(python_examples()))
def test_python_runs_as_it_is_shown(before, example, tmp_path):
    words = {word.split(".")[-1] for word in re.findall(r"[\w.]+", example)}
    for module in {"gymnasium", "stable_baselines3"} & words:
        missing = f"{module}, an optional extra, is not installed"
        pytest.importorskip(module, reason=missing)
    (tmp_path / "out").mkdir()
    for text, shorter in FEWER.items():
        example = example.replace(text, shorter)
    (tmp_path / "shown.py").write_text(example)
    environment = with_search_path(ROOT / "examples")
    commands = [["-m", "barn_eval", *words_of(line)[1:]] for line in before]
    for words in (*commands, ["shown.py"]):
        done = run_python(*words, check=False, cwd=tmp_path, env=environment)
        assert done.returncode == 0, done.stderr


def test_python_examples_are_found():
    ids = {parameters.id for parameters in python_examples()}
    pages = "README.md docs/python.md docs/tutorials/reading_a_bag.md"
    assert {*pages.split(), "barn_eval", "barn_eval.run"} <= ids
    assert len(ids) > 12
