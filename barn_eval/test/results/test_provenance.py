"""The commit that results name is one of the suite's."""

import shutil
import subprocess

import pytest

from barn_eval.results.provenance import commit_of

if shutil.which("git") is None:
    pytest.skip("git is not installed", allow_module_level=True)

NAMED = ("-c", "user.name=a", "-c", "user.email=a@b")


def repository(folder, tracked):
    """Commit a file to a repository and return a folder in it that git ignores."""
    inside = folder / ".venv" / "lib" / "barn_eval"
    inside.mkdir(parents=True)
    (folder / ".gitignore").write_text(".venv\n")
    (folder / tracked).parent.mkdir(parents=True, exist_ok=True)
    (folder / tracked).write_text("<package/>")
    for arguments in (("init", "-q"), ("add", "."), (*NAMED, "commit", "-qm", "first")):
        subprocess.run(["git", "-C", folder, *arguments], check=True)
    return inside


def head(folder):
    return subprocess.check_output(
        ["git", "-C", folder, "rev-parse", "HEAD"], text=True
    ).strip()


@pytest.mark.parametrize(
    "tracked", ["barn_eval/package.xml", "src/suite/barn_eval/package.xml"]
)
def test_the_commit_of_a_repository_with_the_suite(tmp_path, tracked):
    inside = repository(tmp_path, tracked)
    assert commit_of(inside) == head(tmp_path)
    (tmp_path / tracked).write_text("<changed/>")
    assert commit_of(inside) == head(tmp_path) + "+changes"


def test_the_repository_of_another_project_is_not_named(tmp_path):
    assert commit_of(repository(tmp_path, "main.py")) == ""


def test_no_repository(tmp_path):
    assert commit_of(tmp_path) == ""
