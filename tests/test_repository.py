"""What the repository states more than once is the same everywhere.

Its version and its checks.
"""

import json
import os
import re
from collections import Counter
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import pytest
import setuptools  # noqa: F401 -- brings distutils along where Python has none
import yaml
from repository import ROOT
from waiting import run_python

from barn_eval import __version__

PACKAGES = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")


def run_setup(*arguments, **keywords):
    """Run a setup script as far as told and return its distribution."""
    return import_module("distutils.core").run_setup(*arguments, **keywords)


def text_of(name):
    return (ROOT / name).read_text("utf-8")


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_and_its_requirements_have_the_suites_version(package, monkeypatch):
    package_xml = ElementTree.fromstring(text_of(f"{package}/package.xml"))
    assert package_xml.findtext("version") == __version__
    assert import_module(package).__version__ == __version__
    monkeypatch.chdir(ROOT / package)
    built = run_setup("setup.py", stop_after="config")
    assert (built.get_name(), built.get_version()) == (package, __version__)
    required = {name for name in built.install_requires if name.startswith("barn_")}
    depends = {node.text for node in package_xml.iter("exec_depend")} & set(PACKAGES)
    assert required == {f"{name}=={__version__}" for name in depends}


def test_citation_and_changelog_have_the_version_and_its_date():
    citation = yaml.safe_load(text_of("CITATION.cff"))
    assert citation["version"] == __version__
    versions = re.findall(
        r"(?m)^## \[(.+?)\](?: - (\d{4}-\d\d-\d\d))?$", text_of("CHANGELOG.md")
    )
    assert versions[0] == ("Unreleased", "")
    assert versions[1] == (__version__, str(citation["date-released"]))


def test_the_paper_that_is_cited_is_the_one_of_the_front_page():
    (paper,) = yaml.safe_load(text_of("CITATION.cff"))["references"]
    page = " ".join(text_of("README.md").split())
    assert paper["title"] in page
    assert all(author["family-names"] in page for author in paper["authors"])
    assert f"SSRR {paper['year']}" in page


def test_a_new_version_is_written_wherever_the_old_one_stands():
    """The files of bump-my-version's configuration are all that have the version.

    Records of what was made are left out.
    """
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 has no reader of TOML")
    bump = tomllib.loads(text_of("pyproject.toml"))["tool"]["bumpversion"]
    assert bump["current_version"] == __version__
    listed = {"pyproject.toml"}
    for entry in bump["files"]:
        excluded = {
            path for glob in entry.get("glob_exclude", []) for path in ROOT.glob(glob)
        }
        paths = {*ROOT.glob(entry.get("glob") or entry["filename"])} - excluded
        assert paths
        for path in paths:
            searched = entry["search"].format(current_version=__version__)
            pattern = searched if entry.get("regex") else re.escape(searched)
            assert re.search(pattern, path.read_text("utf-8")), (path, searched)
            listed.add(str(path.relative_to(ROOT)))
    records = re.compile(
        r"docs/results.*|barn_.*\.manifest\.json|examples/(template|predictive)_.*|.*/test/.*|.*\.lock|.*\.ipynb"
    )
    stated = {
        str(path.relative_to(ROOT))
        for top in (*PACKAGES, "docker", "docs", "examples", "qa", ".github")
        for path in (ROOT / top).rglob("*")
        if path.suffix in (".py", ".xml", ".md", ".yaml", ".json", ".cfg")
        or path.name.endswith("Dockerfile")
        if re.search(
            rf"(?<![\d.]){re.escape(__version__)}(?![\d.])", path.read_text("utf-8")
        )
    } | {
        path.name
        for path in ROOT.glob("*.*")
        if path.is_file() and __version__ in path.read_text("utf-8")
    }
    assert {name for name in stated if not records.fullmatch(name)} == listed


def recipe(target):
    """Return the commands of a target of the Makefile with its variables put in."""
    text = text_of("Makefile")
    variables = dict(re.findall(r"(?m)^(\w+) :?\??= (.*)$", text))
    variables["BIN"] = ".venv/bin"
    block = re.search(rf"(?m)^{target}:.*\n((?:\t.*\n)+)", text)[1].replace("\\\n", " ")
    return [
        re.sub(r"\$\((\w+)\)", lambda name: variables[name[1]], line.strip())
        for line in block.splitlines()
    ]


def test_a_commit_is_held_to_the_checks_of_make_lint():
    (local,) = yaml.safe_load(text_of(".pre-commit-config.yaml"))["repos"]
    hooks = local["hooks"]
    assert [hook["entry"] for hook in hooks] == recipe("lint")
    for hook in hooks:
        assert (hook["language"], hook["pass_filenames"]) == ("system", False)


def test_no_two_files_of_tests_have_the_same_name():
    """pytest imports them all into one process."""
    folders = [ROOT / top for top in (*PACKAGES, "")]
    files = [path.name for folder in folders for path in folder.glob("test*/*.py")]
    counts = Counter(files)
    assert [name for name in counts if counts[name] > 1] == ["conftest.py"]


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_has_a_key_or_a_note_for_each_library(package, monkeypatch):
    text = text_of(f"{package}/package.xml")
    keys = {node.text for node in ElementTree.fromstring(text).iter("exec_depend")}
    notes = re.findall("<!-- without a rosdep key: (.*) -->", text)
    without = set(re.findall(r"\w+", "".join(notes)))
    monkeypatch.chdir(ROOT / package)
    requirements = run_setup("setup.py", stop_after="config").install_requires
    required = {re.match(r"\w+", line)[0].lower() for line in requirements}
    of_library = {"pillow": "python3-pil", "pyyaml": "python3-yaml"}
    for library in required - set(PACKAGES):
        key = of_library.get(library, f"python3-{library}")
        assert (library in without) != bool({key, f"{key}-pip"} & keys), library


@pytest.mark.skipif(
    "ROSDISTRO" not in os.environ, reason="ROSDISTRO names no checkout of ros/rosdistro"
)
@pytest.mark.parametrize("package", PACKAGES)
def test_rosdep_knows_every_key(package):
    lists = Path(os.environ["ROSDISTRO"])
    keys = {*PACKAGES}
    for name in ("base", "python"):
        text = (lists / f"rosdep/{name}.yaml").read_text("utf-8")
        keys |= set(yaml.safe_load(text))
    text = (lists / "jazzy/distribution.yaml").read_text("utf-8")
    for name, repository in yaml.safe_load(text)["repositories"].items():
        keys |= set(repository.get("release", {}).get("packages", [name]))
    package_xml = ElementTree.fromstring(text_of(f"{package}/package.xml"))
    assert {
        node.text
        for kind in ("exec_depend", "test_depend")
        for node in package_xml.iter(kind)
    } <= keys


def test_a_release_says_what_the_citation_says():
    citation = yaml.safe_load(text_of("CITATION.cff"))
    zenodo = json.loads(text_of(".zenodo.json"))
    assert (zenodo["title"], zenodo["license"]) == (
        citation["title"],
        citation["license"],
    )
    assert zenodo["creators"] == [
        {"name": author["name"]} for author in citation["authors"]
    ]
    assert zenodo["keywords"] == citation["keywords"]
    (related, *_) = zenodo["related_identifiers"]
    (identifier, *_) = citation["references"][0]["identifiers"]
    assert related["identifier"] == identifier["value"]


def test_a_tag_is_released_only_with_its_version_and_notes():
    def release(*words):
        return run_python(ROOT / "qa/release/release.py", *words, check=False)

    assert release("check", f"v{__version__}").returncode == 0
    assert release("notes", __version__).stdout.strip() in text_of("CHANGELOG.md")
    other = release("check", "v99.0.0")
    assert (other.returncode, other.stderr) == (
        1, f"Error: the tag is v99.0.0, the suite is {__version__}: v{__version__} is due\n"
    )  # fmt: skip
    assert (
        "repository-code: https://host/barn"
        in release("citation", "https://host/barn").stdout
    )


def test_every_tool_has_a_line_on_the_page_of_tools():
    page = text_of("qa/README.md")
    tools = [*ROOT.glob("qa/*/*.py"), *ROOT.glob("qa/*/*.sh")]
    assert len(tools) > 20
    missing = [str(tool.relative_to(ROOT)) for tool in tools if tool.name not in page]
    assert missing == []
