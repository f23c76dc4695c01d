"""The front page shows what the repository holds."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def page() -> str:
    file = ROOT / "README.md"
    return file.read_text(encoding="utf-8")


def test_the_planner_shown_is_the_one_that_the_tests_run(page):
    assert (ROOT / "examples" / "simple_planner.py").read_text(encoding="utf-8").strip() in page


def test_links_lead_somewhere(page):
    targets = [part.split(")")[0] for part in page.split("](")[1:]]
    assert len(targets) > 5
    assert [target for target in targets if not (ROOT / target).is_file()] == []
