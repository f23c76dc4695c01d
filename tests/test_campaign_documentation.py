"""What docs/campaigns.md says of files, columns and keys is what there is."""

import re
from pathlib import Path

import pytest
import yaml

from barn_eval.experiments.experiment import Experiment
from barn_eval.experiments.request import read_request
from barn_eval.experiments.rows import results_table, timing_table
from barn_eval.trials.protocol import PAPER_2020
from barn_metrics.bootstrap import RESAMPLES

PAGE = Path(__file__).resolve().parents[1] / "docs" / "campaigns.md"


@pytest.fixture(scope="module")
def page():
    return PAGE.read_text("utf-8")


def columns_of(section):
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    return [name for row in rows for name in re.findall("`(.*?)`", row.split("|")[1])]


def test_every_column_is_described_in_its_order(page):
    _, rest = page.split("`results.*`:\n")
    results, timing = rest.split("`timing.*`:\n")
    assert columns_of(results) == results_table([]).column_names
    assert columns_of(timing) == timing_table([]).column_names


def test_the_file_that_is_shown_is_a_campaign(page, tmp_path):
    block = page.split("`barn run paper.yaml`:\n")[1].split("\nOptions on")[0]
    text = "\n".join(line[4:] for line in block.splitlines())
    path = tmp_path / "paper.yaml"
    path.write_text(text)
    campaign = read_request(path, {})
    assert [planner.name for planner in campaign.experiment.planners] == ["dwa", "eband"]
    assert campaign.experiment.protocol == PAPER_2020
    shown = set(yaml.safe_load(text)) - {"schema_version", "execution", "out"}
    assert set(Experiment.__dataclass_fields__) - shown == {"ros"}


def test_the_number_of_resamples_is_the_codes(page):
    assert f"{RESAMPLES:,}".replace(",", " ") in " ".join(page.split())
