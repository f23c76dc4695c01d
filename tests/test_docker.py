"""Images, compose files and workflow.

What they name exists, and what they pin is what is locked.

No container engine is needed: files are read. That they build is for the workflow to
show.
"""

import re
import shlex
import subprocess
from dataclasses import dataclass, field

import click
import pytest
import yaml
from launch_files import launch_arguments, words_of_arguments
from test_repository import PACKAGES, ROOT

from barn_eval import __version__
from barn_eval.commands.main import cli

DOCKER = ROOT / "docker"


@dataclass
class Stage:
    """A stage of a Dockerfile.

    What it is made from, and its instructions with their arguments.
    """

    base: str
    name: str
    instructions: list[tuple[str, str]] = field(default_factory=list)

    def all(self, keyword):
        return [arguments for name, arguments in self.instructions if name == keyword]


def stages(path):
    """Return the stages of a Dockerfile in order.

    What stands before the first is in one named ''.
    """
    text = re.sub(r"\\\n", " ", re.sub(r"(?m)^\s*#.*\n", "", path.read_text()))
    build_stages = [Stage("", "")]
    for line in filter(str.strip, text.splitlines()):
        keyword, _, arguments = line.strip().partition(" ")
        if keyword == "FROM":
            base, _, name = arguments.partition(" AS ")
            build_stages.append(Stage(base.strip(), name.strip()))
        else:
            build_stages[-1].instructions.append((keyword, " ".join(arguments.split())))
    return build_stages


FILES = sorted(DOCKER.glob("*Dockerfile"))
COMPOSE = sorted(DOCKER.glob("compose*.yaml"))
SUITE = {stage.name or "final": stage for stage in stages(DOCKER / "Dockerfile")[1:]}


def services():
    for path in COMPOSE:
        for name, service in yaml.safe_load(path.read_text())["services"].items():
            yield pytest.param(path, service, id=f"{path.stem}-{name}")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_everything_copied_exists_and_is_sent_to_the_engine(path):
    ignored = (ROOT / ".dockerignore").read_text().split()
    copied = 0
    for stage in stages(path):
        for arguments in stage.all("COPY"):
            *sources, _ = [
                word for word in shlex.split(arguments) if not word.startswith("--")
            ]
            if "--from=" in arguments:
                source = arguments.split("--from=")[1]
                assert source.split()[0] in SUITE
                continue
            for source in sources:
                copied += 1
                assert (ROOT / source).exists(), source
                assert source.split("/")[0] not in ignored
    assert copied


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_bases_and_packages_are_pinned(path):
    names = {stage.name for stage in stages(path)}
    arguments = stages(path)[0].all("ARG")
    defaults = dict(argument.split("=", 1) for argument in arguments)
    for stage in stages(path)[1:]:
        base = re.sub(r"\$\{(\w+)\}", lambda match: defaults[match[1]], stage.base)
        assert base in names or base.startswith("ros:jazzy-ros-base-noble@"), base
        for command in stage.all("RUN"):
            for words in re.findall(r"apt-get install ([^&|;]*)", command):
                packages = [word for word in words.split() if not word.startswith("-")]
                assert packages
                assert [word for word in packages if "=" not in word] == []
            for words in re.findall(r"pip install ([^&|;]*)", command):
                assert re.search(r"--requirement /?\S+(\.lock|/torch\.in)", words), (
                    words
                )
            # Wheels are made of what the lock has checked.
            for words in re.findall(r"pip wheel ([^&|;]*)", command):
                assert re.search(r"--requirement /tmp/\w+\.lock", words), words
    (extraction,) = SUITE["pybullet-lock"].all("RUN")
    command = extraction.replace("/tmp/requirements.lock", "requirements/base.lock")
    words = ["sh", "-c", command.partition(">")[0]]
    lines = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True)
    assert re.fullmatch(
        r"pybullet==[\d.]+ \\\n(?: +--hash=sha256:\w{64}(?: \\)?\n)+", lines.stdout
    )


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_runs_is_no_superuser(path):
    stages_by_name = {stage.name: stage for stage in stages(path)}
    for stage in stages(path)[1:]:
        if stage.all("CMD") or stage.all("ENTRYPOINT") or stage.name == "cluster":
            assert stage.all("USER")[-1] == "10001:10001", stage.name
    last = stages(path)[-1]
    assert last.all("USER") or stages_by_name[last.base].all("USER")


def test_all_packages_are_built_and_all_tests_run():
    copied = {arguments.split()[0] for arguments in SUITE["build"].all("COPY")}
    assert set(PACKAGES) <= copied
    (tests,) = (
        command for command in SUITE["test"].all("RUN") if "colcon_test.sh" in command
    )
    assert tests.split("colcon_test.sh")[1].split() == list(PACKAGES)
    assert (ROOT / tests.split("&& ")[1].split()[0]).is_file()
    assert SUITE["test"].base == "build"
    assert SUITE["final"].base == "runtime"
    assert any(
        "requirements/extra.lock" in command for command in SUITE["test"].all("RUN")
    )
    assert ". ./" in SUITE["test"].all("COPY")


def test_the_entrypoint_can_be_started():
    entrypoint = DOCKER / "entrypoint.sh"
    assert entrypoint.stat().st_mode & 0o111
    assert entrypoint.read_text().startswith("#!/bin/bash\n")
    assert SUITE["runtime"].all("ENTRYPOINT") == ['["/entrypoint.sh"]']


@pytest.mark.parametrize("path, service", list(services()))
def test_a_service_has_a_pinned_image_and_existing_commands(path, service):
    name, _, tag = service["image"].partition(":")
    assert name in ("barn-suite", "barn-nav2")
    assert tag.split("-")[0] == __version__
    if "build" in service:
        dockerfile = (
            path.parent / service["build"]["context"] / service["build"]["dockerfile"]
        )
        assert dockerfile.is_file()
        assert service["build"].get("target", "") in {
            stage.name for stage in stages(dockerfile)
        }
    declared = yaml.safe_load(path.read_text()).get("volumes", {})
    for volume in service.get("volumes", []):
        source = volume.split(":")[0]
        assert source in declared or (path.parent / source).exists(), volume
    words = [*service.get("entrypoint", []), *service.get("command", [])]
    assert words
    runs_known_program(words)


def runs_known_program(words):
    """Assert that a command of a service is the suite's, Ray's or a launch file's."""
    text = re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", " ".join(words))
    for invocation in re.findall(r"\bbarn ([a-z][^&]*)", text):
        name, *arguments = (
            word for word in invocation.split() if not word.startswith("$$")
        )
        command = cli.get_command(click.Context(cli), name)
        assert isinstance(command, click.Command)
        command.make_context(name, arguments)
    launched = [
        (ROOT / a / "launch" / b, c)
        for a, b, c in re.findall(r"ros2 launch (\w+) (\S+\.launch\.py)(.*)", text)
    ]
    launched += [
        (ROOT / "examples" / path, options)
        for path, options in re.findall(r"ros2 launch /(\S+)(.*)", text)
    ]
    for path, options in launched:
        assert words_of_arguments(options) <= launch_arguments(path)
    assert re.search(r"\b(barn|ray start|ros2 launch) ", text), text


def test_containers_that_talk_share_a_network_and_agree_on_how():
    described = yaml.safe_load((DOCKER / "compose.nav2.yaml").read_text())["services"]
    host = described["simulator"]
    assert "network_mode" not in host
    for name in ("nav2", "evaluator"):
        assert described[name]["network_mode"] == "service:simulator"
        assert described[name]["environment"] == host["environment"]
        assert "simulator" in described[name]["depends_on"]
    assert "lockstep:=false" in host["command"]
    assert "real_time_factor:=1.0" in host["command"]


def test_nav2_is_given_the_patience_of_its_page():
    services = yaml.safe_load((DOCKER / "compose.nav2.yaml").read_text())["services"]
    command = [
        word for word in services["evaluator"]["command"] if word.startswith("patience")
    ]
    page = (ROOT / "docs/nav2.md").read_text()
    documented = {*re.findall(r"--ros (patience\.\w+=\d+)", page)}
    assert {word.replace(":=", "=") for word in command} == documented


def test_kernels_are_compiled_into_the_image_outside_of_the_volume():
    (environment,) = SUITE["base"].all("ENV")
    (folder,) = re.findall(r"NUMBA_CACHE_DIR=(\S+)", environment)
    assert not folder.startswith("/data")
    (run,) = SUITE["runtime"].all("RUN")
    assert "compile_kernels.sh" in run and f"chmod -R a+rwX {folder}" in run
    assert any(folder in command for command in SUITE["base"].all("RUN"))
    script = DOCKER / "compile_kernels.sh"
    assert script.stat().st_mode & 0o111
    assert "docker/compile_kernels.sh" in (ROOT / "Makefile").read_text()


def test_planners_can_be_kept_apart_as_the_page_says():
    page = " ".join((ROOT / "docs/fairness.md").read_text().split())
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    options = services["apart"]["security_opt"]
    assert " ".join(f"--security-opt {option}" for option in options) in page
    assert services["apart"]["command"] == services["demo"]["command"]
