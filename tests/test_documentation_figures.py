"""The figures of the documentation: drawn by one command, shown with a text that says what is on them."""

import re
import shutil
from pathlib import Path

import figures as tool

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"


def test_one_command_draws_all_figures_but_those_it_names(tmp_path, capsys):
    for name in ("results.json", "results_origin.json", "carry_over.csv"):
        shutil.copy(DOCS / name, tmp_path)
    assert tool.main([str(tmp_path), "--dataset", "barn_test"]) == 0
    drawn = {path.name for path in (tmp_path / "figures").iterdir()}
    shown = capsys.readouterr().out
    assert all(f"{tmp_path / 'figures' / name}\n" in shown for name in drawn)
    assert {path.name for path in (DOCS / "figures").iterdir()} == drawn | tool.ELSEWHERE.keys()
    assert not drawn & tool.ELSEWHERE.keys()
    assert all(f"{name} is left as it is: " in shown for name in tool.ELSEWHERE)


def test_a_folder_without_results_is_one_line(tmp_path, capsys):
    assert tool.main([str(tmp_path)]) == 1
    assert re.fullmatch(r"error: [^\n]*results\.json[^\n]*\n", capsys.readouterr().err)


def test_every_figure_is_shown_with_a_text_that_says_what_is_on_it():
    pages = [ROOT / "README.md", *DOCS.rglob("*.md")]
    texts = [page.read_text("utf-8") for page in pages]
    found = [match for text in texts for match in re.findall(r"!\[([^\]]*)\]\(([^)]*figures/[^)]*)\)", text)]
    tags = [match for text in texts for match in re.findall(r'<img src="([^"]*figures/[^"]*)" alt="([^"]*)"', text)]
    found += [(about, target) for target, about in tags]
    assert {Path(target).name for _, target in found} == {path.name for path in (DOCS / "figures").iterdir()}
    assert [target for text, target in found if len(text.split()) < 3] == []
