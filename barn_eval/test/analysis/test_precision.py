"""How many worlds a precision needs, from results: against the formulas, and through the command."""

import json
from dataclasses import replace

import numpy as np
import pytest
from analysis.test_compare import folders, results  # noqa: F401 (a fixture)
from click.testing import CliRunner

from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.precision import (
    REPETITIONS,
    estimate_precision,
    figures_table,
    needs_table,
)
from barn_eval.analysis.significance import (
    half_width,
    variance_components,
    worlds_for_difference,
    worlds_for_half_width,
)
from barn_eval.commands.compare import precision as command
from barn_worlds.base.errors import ConfigError


def values(rows):
    time = MEASURES["normalised_time_s_per_m"].values(rows)
    return time, np.array([row.world for row in rows])


def test_needs_are_those_of_the_components_of_variance():
    dwa = results()
    eband = results("eband", 1.0, seed=3)
    precision = estimate_precision({"dwa": dwa, "eband": eband}, 0.1, 0.2)
    assert precision.measure == "normalised_time_s_per_m"
    assert [figure.of for figure in precision.figures] == [
        "DWA",
        "E-Band",
        "DWA - E-Band",
    ]
    parts = [variance_components(*values(dwa)), variance_components(*values(eband))]
    parts.append(variance_components(values(dwa)[0] - values(eband)[0], values(dwa)[1]))
    assert [len(figure.parts.unseen) for figure in precision.figures] == [
        1,
        1,
        2,
    ]  # nobody has failed
    parts = [
        replace(figure, unseen=other.parts.unseen)
        for figure, other in zip(parts, precision.figures, strict=True)
    ]
    assert [figure.parts for figure in precision.figures] == parts
    assert precision.figures[0].half_width == half_width(parts[0], 20, 3)
    assert [
        (figure.of, figure.kind, figure.wanted, figure.repetitions, figure.worlds)
        for figure in precision.needs
    ] == [
        *(
            (
                "DWA",
                "half_width",
                0.1,
                count,
                worlds_for_half_width(parts[0], 0.1, count),
            )
            for count in REPETITIONS
        ),
        *(
            (
                "E-Band",
                "half_width",
                0.1,
                count,
                worlds_for_half_width(parts[1], 0.1, count),
            )
            for count in REPETITIONS
        ),
        *(
            (
                "DWA - E-Band",
                "difference",
                0.2,
                c,
                worlds_for_difference(parts[2], 0.2, c),
            )
            for c in REPETITIONS
        ),
    ]
    assert precision.notes == ()


def test_five_percent_of_the_mean_is_the_default():
    (need,) = estimate_precision({"dwa": results()}, repetitions=4).needs
    assert need.wanted == pytest.approx(0.05 * values(results())[0].mean())
    assert need.repetitions == 4


def test_what_the_results_cannot_say_is_said():
    single = [row for row in results(worlds=4) if row.repetition == 0]
    few, alone = estimate_precision({"dwa": single}).notes
    assert few.startswith("Only 4 worlds")
    assert alone.startswith("With one trial per world nothing is known of how alike")
    assert {row.repetitions for row in estimate_precision({"dwa": single}).needs} == {1}
    with pytest.raises(
        ConfigError, match="DWA: 1 world with time per meter as counted cannot say"
    ):
        estimate_precision({"dwa": results(worlds=1)})
    message = "a difference needs two planners; there are 1: dwa; choose two as FOLDER:PLANNER,PLANNER"
    with pytest.raises(ConfigError, match=message):
        estimate_precision({"dwa": results()}, size=0.1)
    with pytest.raises(
        ConfigError, match="unknown measure 'succes'; did you mean 'success'"
    ):
        estimate_precision({"dwa": results()}, measure_key="succes")


def test_tables_have_a_row_per_figure_and_repetitions():
    precision = estimate_precision(
        {"dwa": results(), "eband": results("eband", 1.0, seed=3)}, 0.1, 1e-9
    )
    assert [row[0] for row in figures_table(precision).rows] == [
        "DWA",
        "E-Band",
        "DWA - E-Band",
    ]
    table = needs_table(precision)
    assert table.columns[1:3] == ("DWA to +- 0.100", "E-Band to +- 0.100")
    assert [row[0] for row in table.rows] == [
        "1 trial",
        "2 trials",
        "3 trials",
        "5 trials",
        "10 trials",
    ]
    assert {row[3] for row in table.rows} == {"over a million"}
    assert [row[1] for row in table.rows] == [
        str(need.worlds) for need in precision.needs if need.of == "DWA"
    ]


def test_a_set_that_is_too_small_is_said_to_be(folders):  # noqa: F811 (a fixture)
    of_300 = [replace(trial, dataset="barn300") for trial in results()]
    precision = estimate_precision({"dwa": of_300}, width=0.001)
    assert precision.available == 300
    assert precision.notes[-1].startswith("The set has 300 worlds")
    assert {row[1] for row in needs_table(precision).rows} == {"over 300"}
    three = {"dwa": results(), "eband": results("eband"), "gap": results("gap")}
    assert (
        estimate_precision(three).notes[0]
        == "For a difference choose two of the 3 planners as FOLDER:PLANNER,PLANNER."
    )


def test_the_command_takes_one_or_two_planners_of_a_folder(folders):  # noqa: F811
    def invoke(*arguments):
        return CliRunner().invoke(
            command, [*map(str, arguments)], catch_exceptions=False
        )

    both = folders / "both"
    content = json.loads(
        invoke(both, "--difference", "0.1", "--repetitions", "3", "--json").output
    )
    assert [entry["of"] for entry in content["needs"]] == [
        "DWA",
        "E-Band",
        "DWA - E-Band",
    ]
    assert content["needs"][2]["wanted"] == 0.1
    content = json.loads(
        invoke(f"{both}:eband", "--measure", "success", "--json").output
    )
    assert (content["measure"], [entry["of"] for entry in content["figures"]]) == (
        "success",
        ["E-Band"],
    )
    content = json.loads(invoke(f"{both}:eband,dwa", "--json").output)
    assert content["figures"][2]["of"] == "E-Band - DWA"
    assert "Worlds needed" in invoke(both).output
    assert "--half-width" in invoke(both, "--half-width", "0").output
    with pytest.raises(ConfigError, match="has no planner 'dwo'; did you mean 'dwa'"):
        invoke(f"{both}:dwo")
