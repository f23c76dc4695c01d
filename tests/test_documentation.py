"""The figures of the documentation are drawn by one command and described.

docs/campaigns.md says what there is.
"""

import re
import shutil
from dataclasses import fields
from pathlib import Path

import figures as tool
import pytest
import yaml
from repository import DOCS, ROOT

from barn_eval.results.rows import results_table, timing_table
from barn_eval.running.request import read_request
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.system import ObservedTrial
from barn_metrics.bootstrap import RESAMPLES

# Words of prose and of table cells that a page may have; code, figures and generated
# parts do not count.
WORDS = yaml.safe_load("""
../CHANGELOG: 2000
../SECURITY: 400
../barn_eval/README: 750
../barn_sim/README: 800
../barn_worlds/README: 700
../examples/nav2/README: 600
../examples/nav2/lockstep/README: 350
../qa/README: 520
architecture: 1400
boards: 950
campaigns: 1750
carry_over: 550
dynamic: 1300
efficiency: 650
fairness: 1400
fidelity: 1150
hard_worlds: 500
ideal_robot: 300
learning: 1000
metrics: 950
mutation: 220
nav2: 900
outdoors: 550
reliability: 650
results: 650
protocols: 700
python: 750
reports: 1150
robots: 1200
statistics: 800
troubleshooting: 1600
tutorials/other_stacks: 750
tutorials/own_world: 750
tutorials/tuning: 450
""")

CAMPAIGNS = (DOCS / "campaigns.md").read_text("utf-8")


def test_one_command_draws_all_figures_but_those_it_names(tmp_path, capsys):
    for name in ("results.json", "results_origin.json", "carry_over.csv"):
        shutil.copy(DOCS / name, tmp_path)
    assert tool.main([str(tmp_path)]) == 0
    figures = {path.name for path in (tmp_path / "figures").iterdir()}
    output = capsys.readouterr().out
    folder = tmp_path / "figures"
    assert all(f"{folder / name}\n" in output for name in figures)
    shown = {path.name for path in (DOCS / "figures").iterdir()}
    assert shown == figures | tool.ELSEWHERE.keys()
    assert not figures & tool.ELSEWHERE.keys()
    assert all(f"{name} is left as it is: " in output for name in tool.ELSEWHERE)


def test_a_folder_without_results_is_one_line(tmp_path, capsys):
    assert tool.main([str(tmp_path)]) == 1
    assert re.fullmatch(r"error: [^\n]*results\.json[^\n]*\n", capsys.readouterr().err)


def test_every_figure_has_a_text_that_describes_it():
    pages = [ROOT / "README.md", *DOCS.rglob("*.md")]
    text = "\n".join(page.read_text("utf-8") for page in pages)
    images = re.findall(r"!\[([^\]]*)\]\(([^)]*figures/[^)]*)\)", text)
    tags = re.findall(r'<img src="([^"]*figures/[^"]*)" alt="([^"]*)"', text)
    images += [(description, target) for target, description in tags]
    names = {path.name for path in (DOCS / "figures").iterdir()}
    assert {Path(target).name for _, target in images} == names
    unexplained = [target for text, target in images if len(text.split()) < 3]
    assert unexplained == []


def columns_of(section):
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    return [name for row in rows for name in re.findall("`(.*?)`", row.split("|")[1])]


def test_every_column_is_described_in_its_order():
    _, rest = CAMPAIGNS.split("`results.*`:\n")
    results, timing = rest.split("`timing.*`:\n")
    assert columns_of(results) == results_table([]).column_names
    assert columns_of(timing) == timing_table([]).column_names
    observed = (DOCS / "outdoors.md").read_text("utf-8").split("| unknown |")[0]
    assert columns_of(observed) == [item.name for item in fields(ObservedTrial)]


def test_the_file_that_is_shown_is_a_campaign(tmp_path):
    _, following = CAMPAIGNS.split("`barn run paper.yaml`:\n")
    block, _ = following.split("\nOptions override")
    text = "\n".join(line[4:] for line in block.splitlines())
    path = tmp_path / "paper.yaml"
    path.write_text(text)
    campaign = read_request(path, {})
    assert [planner.name for planner in campaign.config.planners] == ["dwa", "eband"]
    assert campaign.config.protocol == PAPER_2020
    keys = set(yaml.safe_load(text)) - {"schema_version", "execution", "out"}
    assert set(RunConfig.__dataclass_fields__) - keys == {"ros", "system"}


def test_the_number_of_resamples_is_the_codes():
    resamples = f"{RESAMPLES:,}".replace(",", " ")
    assert resamples in " ".join(CAMPAIGNS.split())


def words_of(text):
    """Return the words of a page, without code, tags, link targets and generated parts."""
    without_code = re.sub(r"(?ms)^```.*?^```|^ {4}.*?$", "", text)
    by_hand = re.sub(
        r"(?s)<!-- ([\w ]+): begin -->.*?<!-- \1: end -->", "", without_code
    )
    without_tags = re.sub(r"<[a-z/][^>\n]*>", " ", by_hand)
    without_targets = re.sub(r"\]\([^)]*\)", "]", without_tags)
    return [word for word in without_targets.split() if re.search("[A-Za-z]{2}", word)]


def test_words_are_those_of_the_prose():
    text = (
        "# A page\n\nTwo [words](of/a/path.md).\n\n    barn run\n\n| x | 3 [2, 4] |\n"
    )
    text += "<!-- a table: begin -->\nnot counted\n<!-- a table: end -->\n"
    text += "```python\nimport barn_eval\n```\n"
    assert words_of(text) == ["page", "Two", "[words]."]


def test_all_pages_by_hand_have_at_most_35_000_words():
    text = (ROOT / "mkdocs.yml").read_text("utf-8")
    pages = set(re.findall(r"[\w./]+\.md", text))
    # A record of changes, bounded above, and a page that `barn reproduce` writes.
    pages -= {"CHANGELOG.md", "docs/results.md"}
    assert len(pages) > 60
    counts = [len(words_of((ROOT / page).read_text("utf-8"))) for page in pages]
    assert sum(counts) <= 35_000


@pytest.mark.parametrize("name", WORDS)
def test_a_page_is_short_and_begins_with_what_the_reader_gets(name):
    text = (DOCS / f"{name}.md").read_text("utf-8")
    assert len(words_of(text)) <= WORDS[name]
    title, opening = text.split("\n\n")[:2]
    assert re.fullmatch("# .+", title)
    assert re.match(r"[A-Z`*]", opening)
    assert len(words_of(opening)) <= 60
