"""What rests on an ideal robot: the page shows what its command makes of the trials."""

import csv

import ideal_robot as tool
from click.testing import CliRunner
from repository import DOCS


def test_the_page_shows_what_its_command_makes(tmp_path):
    source = DOCS / "ideal_robot.csv"
    copied = tmp_path / "copy.csv"
    done = CliRunner().invoke(tool.main, [str(source), "--csv", str(copied)])
    assert done.exit_code == 0, done.output
    assert done.output.strip() in (DOCS / "ideal_robot.md").read_text("utf-8")
    assert copied.read_bytes() == source.read_bytes()


def test_a_change_is_of_pairs_in_the_same_worlds():
    trials = [
        tool.Trial(run, "gap", world, 1, efficiency + 0.01 * world)
        for run, efficiency in (("one_a", 0.5), ("one_b", 0.4), ("two_a", 0.1))
        for world in range(12)
    ]
    rows = list(csv.reader(tool.results_table(trials).splitlines(), delimiter="|"))
    changes = {row[2].strip(): row[5].split() for row in rows[2:]}
    assert changes["`one_a`"] == changes["`two_a`"] == []
    assert changes["`one_b`"][0] == "-10.0"
