"""Workflows: what they name exists, what they pin is pinned by digest, names are valid.

They run on GitHub only; here they are read.
"""

import os
import re
import shlex
import subprocess
from itertools import chain
from pathlib import Path
from xml.etree.ElementTree import parse

import audit
import pytest
import yaml
from test_docker import FILES, SUITE
from test_repository import ROOT

from barn_eval.trials.protocol import PROTOCOLS

SUITES = sorted((ROOT / ".github/workflows").glob("*.yaml"))
OTHERS = [
    ROOT / "examples/leaderboard/.github/workflows/board.yaml",
    ROOT / "examples/nav2/compare_builds.yaml",
]
CI, RELEASE = SUITES
# Files that a step or a checkout of another repository brings along.
MADE = re.compile(r"(out|dist|site|build|wheels|results\.jsonl|notes\.md)\b")


def steps_of(path):
    """Return the steps of all jobs of a workflow."""
    jobs = yaml.safe_load(path.read_text())["jobs"]
    return [step for job in jobs.values() for step in job["steps"]]


@pytest.mark.parametrize("path", SUITES + OTHERS, ids=lambda path: path.name)
def test_actions_are_pinned_by_digest_beside_their_release(path):
    text = path.read_text()
    lines = [line for line in text.splitlines() if "uses:" in line]
    assert len(lines) == sum("uses" in step for step in steps_of(path))
    for line in lines:
        pin = r"uses: [\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+"
        assert re.search(pin + "$", line), line


def test_an_action_has_one_digest_everywhere():
    pins = set()
    for path in SUITES + OTHERS:
        pins |= {step["uses"] for step in steps_of(path) if "uses" in step}
    assert len({pin.partition("@")[0] for pin in pins}) == len(pins)


@pytest.mark.parametrize("path", SUITES, ids=lambda path: path.name)
def test_files_and_targets_that_a_workflow_names_exist(path):
    targets = set(re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text()))
    workflow = yaml.safe_load(path.read_text())
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert job["timeout-minutes"]
    for step in steps_of(path):
        inputs = step.get("with", {})
        assert inputs.get("target", "test") in SUITE
        assert (ROOT / inputs.get("file", "README.md")).is_file()
        for lock in inputs.get("cache-dependency-path", "README.md").split():
            assert (ROOT / lock).is_file()
        run = step.get("run", "")
        assert set(re.findall(r"\bmake ([\w-]+)", run)) <= targets
        for word in re.split(r"[\s'\"]+", run):
            is_path = re.fullmatch(r"[\w./-]+/[\w.-]+\.(py|sh|txt|yaml|lock)", word)
            if is_path and not word.startswith("/") and not MADE.match(word):
                assert (ROOT / word).is_file(), word


def test_the_suite_is_tested_on_all_its_pythons():
    jobs = yaml.safe_load(CI.read_text())["jobs"]
    matrix = jobs["pypi"]["strategy"]["matrix"]
    assert matrix == {"python": ["3.10", "3.11", "3.12"]}


def test_jobs_of_nav2_name_files_and_protocols_that_exist():
    jobs = yaml.safe_load(CI.read_text())["jobs"]
    for job in jobs["nav2"]["strategy"]["matrix"]["include"]:
        assert (ROOT / f"examples/nav2/params/{job['controller']}.yaml").is_file()
        protocol = PROTOCOLS[job["protocol"]]
        assert protocol.map_given == (job["map"] == "true")
    (branches,) = re.findall(r"for branch in ([\w ]+);", CI.read_text())
    for branch in branches.split():
        assert (ROOT / f"examples/nav2/expected_failures_{branch}.txt").is_file()
    variables = set(jobs["nav2"]["env"])
    text = (ROOT / "docker/compose.nav2.yaml").read_text()
    assert variables <= set(re.findall(r"\$\{(\w+):-", text))


@pytest.mark.parametrize("owner", ["someone/barn", "Some-One/BARN_Suite"])
def test_the_name_of_a_released_image_is_valid(owner, tmp_path):
    job = yaml.safe_load(RELEASE.read_text())["jobs"]["image"]
    default = re.search(r"vars\.REGISTRY \|\| '([\w.]+)'", job["env"]["REGISTRY"])[1]
    (step,) = (step for step in job["steps"] if step.get("id") == "image")
    output = tmp_path / "output"
    variables = {"GITHUB_REPOSITORY": owner, "GITHUB_OUTPUT": str(output)}
    variables |= {"REGISTRY": default, "PATH": os.environ["PATH"]}
    subprocess.run(["bash", "-c", step["run"]], check=True, env=variables)
    name = output.read_text().strip().removeprefix("name=")
    assert re.fullmatch(r"[a-z0-9.]+(/[a-z0-9]+([._-]+[a-z0-9]+)*)+", name)
    (push,) = (step for step in job["steps"] if "push" in step.get("with", {}))
    assert push["with"]["tags"].startswith("${{ steps.image.outputs.name }}:")


def pins_of(lock):
    text = (ROOT / f"requirements/{lock}.lock").read_text()
    return set(re.findall(r"(?m)^([\w.-]+(?:\[\w+\])?==[^\\\n]*?) *\\?$", text))


@pytest.mark.parametrize("lock", ["python", "users"])
def test_the_locks_of_users_have_the_releases_of_the_lock(lock):
    wanted = (ROOT / "requirements/python.in").read_text().splitlines()
    names = {line.lower() for line in wanted if not line.startswith("#")}
    pins = pins_of(lock)
    assert pins <= pins_of("base")
    packages = {pin.partition("==")[0].lower() for pin in pins}
    assert names <= packages
    tools = {"colcon-core", "mypy", "ruff", "bandit", "pytest", "hypothesis", "wheel"}
    assert not tools & packages
    assert ("ros-jazzy-rclpy" in packages) == (lock == "users")


@pytest.mark.parametrize(
    "path", sorted((ROOT / "requirements").glob("*.lock")), ids=lambda path: path.stem
)
def test_every_file_of_a_lock_has_its_hash(path):
    for package in re.split(r"\n(?=[\w.-]+(?:\[|==))", path.read_text()):
        assert re.match(r"[^\n]*==[^\n]* \\\n +--hash=sha256:\w{64}", package), package


def test_the_audit_asks_for_every_package_of_the_locks():
    def releases(locks):
        pins = set().union(*(pins_of(lock) for lock in locks))
        return {pin.partition(" ;")[0] for pin in pins}

    locks = {path.stem for path in (ROOT / "requirements").glob("*.lock")}
    audited = {Path(name).stem for name in audit.LOCKS if name.endswith(".lock")}
    assert audited < locks
    assert releases(locks) <= releases(audited)
    assert "requirements/torch.in" in audit.LOCKS


def test_images_of_ros_are_pinned_by_one_digest():
    texts = [path.read_text() for path in [*SUITES, *OTHERS, *FILES]]
    images = re.findall(r"\bros:jazzy\S*", "\n".join(texts))
    assert len(images) >= len(FILES)
    (image,) = set(images)
    assert re.fullmatch(r"ros:jazzy-ros-base-noble@sha256:[0-9a-f]{64}", image)


def test_the_page_leads_from_an_empty_machine_to_a_workspace():
    page = (ROOT / "docs/install.md").read_text()
    (install,) = re.findall(r"pip install -r src/barn/(\S+)", page)
    assert (ROOT / install).is_file() and install.endswith(".lock")
    (skipped,) = re.findall(r'--skip-keys "\$\((.*)\)"', page)
    command = skipped.replace("src/barn/", "")
    done = subprocess.run(
        ["bash", "-c", command], cwd=ROOT, check=True, capture_output=True, text=True
    )
    keys = set(shlex.split(done.stdout))
    nodes = chain(*(parse(path).iter() for path in ROOT.glob("barn_*/package.xml")))
    texts = {node.text for node in nodes if node.text}
    assert keys == {text for text in texts if text.startswith("python3-")}


def test_one_submission_that_does_not_hold_does_not_freeze_the_board():
    jobs = yaml.safe_load(OTHERS[0].read_text())["jobs"]
    (upload,) = (
        step
        for step in jobs["verify"]["steps"]
        if "upload-pages-artifact" in step.get("uses", "")
    )
    for part in (upload, jobs["publish"]):
        assert "!cancelled() && github.event_name == 'push'" in part["if"]
