"""The suite's own data set stays near the paper's Table II.

docs/metrics.md shows what it gives.
"""

import metrics_figures as page_tool
import pytest
from repository import DOCS

from barn_metrics.metrics import METRIC_NAMES
from barn_metrics.report import TABLE_II, metrics_table
from barn_worlds.datasets.dataset import open_dataset


@pytest.fixture(scope="module")
def barn300():
    return open_dataset("barn300")


@pytest.fixture(scope="module")
def table(barn300):
    return metrics_table(barn300, "published")


@pytest.mark.parametrize("name", METRIC_NAMES)
def test_statistics_lie_near_table_ii(table, name):
    published = TABLE_II[name]
    column = METRIC_NAMES.index(name)
    values = table.values[:, column]
    assert len(values) == 300
    assert abs(values.mean() - published["mean"]) <= 0.1 * published["std"]
    assert 0.8 <= values.std() / published["std"] <= 1.15


def test_the_page_shows_the_tables_of_the_data_set(barn300, table):
    page = (DOCS / "metrics.md").read_text()
    for text in (
        page_tool.table_i(barn300),
        page_tool.table_ii(table),
        page_tool.variants_table(barn300),
    ):
        assert text in page


def test_a_data_set_that_is_not_there_is_one_line(tmp_path, capsys):
    arguments = [str(tmp_path / "figures"), "--dataset", str(tmp_path / "none")]
    assert page_tool.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
