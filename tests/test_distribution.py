"""The suite as one distribution.

A wheel has all that the five packages have, and knows its commit.
"""

import re
import subprocess
import zipfile
from email import message_from_bytes

import pytest
from test_repository import PACKAGES, ROOT, run_setup
from waiting import run_python

from barn_eval import __version__


def git(*arguments):
    words = ["git", "-C", ROOT, *arguments]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    return done.stdout.split()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    if not git("rev-parse", "HEAD"):
        pytest.skip("this is no repository, so a wheel would have no commit")
    place = tmp_path_factory.mktemp("distribution")
    clone = place / "clone"
    subprocess.run(
        ["git", "clone", "--quiet", "--no-hardlinks", str(ROOT), clone], check=True
    )
    # As a release does: an archive of the source, and the wheel of this archive.
    run_python("-c", "import build_backend as b; b.build_sdist('..')", cwd=clone)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "-w", place]
    run_python("-m", "pip", "wheel", *options, *place.glob("*.tar.gz"))
    (file,) = place.glob("*.whl")
    return zipfile.ZipFile(file)


def test_it_has_every_file_of_the_packages(wheel):
    tracked = git("ls-files", *(f"{package}/{package}" for package in PACKAGES))
    assert {name.split("/", 1)[1] for name in tracked} <= set(wheel.namelist())
    assert not [name for name in wheel.namelist() if "/test/" in name]


def test_ros_finds_packages_launch_files_and_parameters(wheel):
    share = f"barn_suite-{__version__}.data/data/share"
    places = {"launch", "config", "package.xml"}
    tracked = [
        name for name in git("ls-files", *PACKAGES) if name.split("/")[1] in places
    ]
    assert len(tracked) > 20
    index = [
        f"{share}/ament_index/resource_index/packages/{package}" for package in PACKAGES
    ]
    shared = {f"{share}/{name}" for name in tracked}
    assert {*index, *shared} <= set(wheel.namelist())


def test_it_requires_what_the_packages_require(wheel, monkeypatch):
    (name,) = (
        name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")
    )
    metadata = message_from_bytes(wheel.read(name))
    assert metadata["Version"] == __version__
    needed = {}
    for package in PACKAGES:
        monkeypatch.chdir(ROOT / package)
        for requirement in run_setup("setup.py", stop_after="config").install_requires:
            library, version = re.fullmatch(
                r"(\w+)(?:>=|==)?(.*)", requirement
            ).groups()
            numbers = tuple(map(int, version.split("."))) if version else ()
            needed.setdefault(library, set()).add(numbers)
    stated = {}
    for requirement in metadata.get_all("Requires-Dist"):
        if "extra" not in requirement:
            library, version = re.fullmatch(r"(\w+)>=([\d.]+)", requirement).groups()
            stated[library] = tuple(map(int, version.split(".")))
    libraries = needed.keys() - set(PACKAGES)
    assert stated == {library: max(needed[library]) for library in libraries}


def test_installed_it_says_its_commit(wheel, tmp_path):
    wheel.extractall(tmp_path / "installed")
    script = "from barn_eval.results.provenance import commit, versions; print(commit(), versions()['barn_sim'])"
    environment = {"PYTHONPATH": str(tmp_path / "installed"), "PATH": "/usr/bin:/bin"}
    done = run_python("-c", script, env=environment, cwd=tmp_path)
    assert done.stdout.split() == [*git("rev-parse", "HEAD"), __version__]
