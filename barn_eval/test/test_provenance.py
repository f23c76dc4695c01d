"""The commit that results name is one of the suite's."""

import shutil
import subprocess

import pytest

from barn_eval.experiments.run_file import commit_of

if shutil.which("git") is None:
    pytest.skip("git is not installed", allow_module_level=True)

NAMED = ("-c", "user.name=a", "-c", "user.email=a@b")


@pytest.fixture
def repository(tmp_path):
    """Return a function that commits a file to a repository and returns a folder in it that git ignores."""

    def made(tracked: str):
        inside = tmp_path / ".venv" / "lib" / "barn_eval"
        inside.mkdir(parents=True)
        (tmp_path / ".gitignore").write_text(".venv\n")
        (tmp_path / tracked).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / tracked).write_text("<package/>")
        for arguments in (("init", "-q"), ("add", "."), (*NAMED, "commit", "-qm", "first")):
            subprocess.run(["git", "-C", tmp_path, *arguments], check=True)
        return inside

    return made


def head(folder):
    return subprocess.run(
        ["git", "-C", folder, "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.parametrize("tracked", ["barn_eval/package.xml", "src/suite/barn_eval/package.xml"])
def test_the_commit_of_a_repository_with_the_suite(repository, tmp_path, tracked):
    inside = repository(tracked)
    assert commit_of(inside) == head(tmp_path)
    (tmp_path / tracked).write_text("<changed/>")
    assert commit_of(inside) == head(tmp_path) + "+changes"


def test_the_repository_of_another_project_is_not_named(repository):
    assert commit_of(repository("main.py")) == ""


def test_no_repository(tmp_path):
    assert commit_of(tmp_path) == ""
