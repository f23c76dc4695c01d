"""How many worlds a precision needs, from results.

Against the formulas, and through the command.
"""

from dataclasses import replace

import numpy as np
import pytest
from analysis.test_compare import folders, results, scored  # noqa: F401 (a fixture)
from refusals import refused

from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.precision import (
    REPETITIONS,
    Need,
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

NAMES = ["DWA", "E-Band", "DWA - E-Band"]


def values(rows):
    time = MEASURES["normalised_time_s_per_m"].values(rows)
    return time, np.array([row.world for row in rows])


def test_needs_are_those_of_the_components_of_variance():
    dwa = results()
    eband = results("eband", 1.0, seed=3)
    precision = estimate_precision({"dwa": dwa, "eband": eband}, 0.1, 0.2)
    assert precision.measure == "normalised_time_s_per_m"
    times_a, worlds = values(dwa)
    times_b, _ = values(eband)
    parts = [
        variance_components(times, worlds)
        for times in (times_a, times_b, times_a - times_b)
    ]
    for place, figure in enumerate(precision.figures):
        assert figure.of == NAMES[place]
        # nobody has failed
        assert len(figure.parts.unseen) == (1, 1, 2)[place]
        parts[place] = replace(parts[place], unseen=figure.parts.unseen)
        assert figure.parts == parts[place]
    assert len(precision.figures) == 3
    assert precision.figures[0].half_width == half_width(parts[0], 20, 3)
    width = ("half_width", 0.1, worlds_for_half_width)
    wants = (width, width, ("difference", 0.2, worlds_for_difference))
    expected = []
    for name, components, want in zip(NAMES, parts, wants, strict=True):
        kind, wanted, worlds = want
        for count in REPETITIONS:
            needed = worlds(components, wanted, count)
            expected.append(Need(name, kind, wanted, count, needed))
    assert precision.needs == expected
    assert precision.notes == []


def test_five_percent_of_the_mean_is_the_default():
    (need,) = estimate_precision({"dwa": results()}, repetitions=4).needs
    assert need.wanted == pytest.approx(0.05 * values(results())[0].mean())
    assert need.repetitions == 4


def test_what_the_results_cannot_say_is_said():
    single = [row for row in results(worlds=4) if row.repetition == 0]
    few, alone = estimate_precision({"dwa": single}).notes
    assert few.startswith("Only 4 worlds")
    assert alone.startswith(
        "With one trial per world, the data do not show how similar"
    )
    assert {row.repetitions for row in estimate_precision({"dwa": single}).needs} == {1}
    with refused("DWA: 1 world with time per meter as counted cannot show"):
        estimate_precision({"dwa": results(worlds=1)})
    message = "a difference needs two planners, got 1: dwa; select two as FOLDER:PLANNER,PLANNER"
    with refused(message):
        estimate_precision({"dwa": results()}, size=0.1)
    with refused("unknown measure 'succes'; did you mean 'success'"):
        estimate_precision({"dwa": results()}, measure_key="succes")


def test_tables_have_a_row_per_figure_and_repetitions():
    planners = {"dwa": results(), "eband": results("eband", 1.0, seed=3)}
    precision = estimate_precision(planners, 0.1, 1e-9)
    assert [row[0] for row in figures_table(precision).rows] == NAMES
    table = needs_table(precision)
    assert table.columns[1:3] == ("DWA to +- 0.100", "E-Band to +- 0.100")
    counts = ", ".join(row[0] for row in table.rows)
    assert counts == "1 trial, 2 trials, 3 trials, 5 trials, 10 trials"
    assert {row[3] for row in table.rows} == {"over a million"}
    worlds = [need.worlds for need in precision.needs if need.of == "DWA"]
    assert [row[1] for row in table.rows] == list(map(str, worlds))


def test_a_set_that_is_too_small_is_said_to_be(folders):  # noqa: F811 (a fixture)
    of_300 = [replace(trial, dataset="barn300") for trial in results()]
    precision = estimate_precision({"dwa": of_300}, width=0.001)
    assert precision.available == 300
    assert precision.notes[-1].startswith("The data set has only 300 worlds")
    assert {row[1] for row in needs_table(precision).rows} == {"over 300"}
    three = {"dwa": results(), "eband": results("eband"), "gap": results("gap")}
    note = "For a difference, select two of the 3 planners as FOLDER:PLANNER,PLANNER."
    assert estimate_precision(three).notes[0] == note


def test_the_command_takes_one_or_two_planners(
    folders,  # noqa: F811
    succeed,
    printed,
    rejected,
):
    both = folders / "both"
    content = printed(f"precision {both} --difference 0.1 --repetitions 3")
    assert [need["of"] for need in content["needs"]] == NAMES
    assert content["needs"][2]["wanted"] == 0.1
    content = printed(f"precision {both}:eband --measure success")
    assert content["measure"] == "success"
    assert [figure["of"] for figure in content["figures"]] == ["E-Band"]
    content = printed(f"precision {both}:eband,dwa")
    assert content["figures"][2]["of"] == "E-Band - DWA"
    assert "Worlds needed" in succeed(f"precision {both}")
    for line, message in (
        (f"{both} --half-width 0", "--half-width"),
        (f"{both}:dwo", "no planner 'dwo'; did you mean 'dwa'"),
    ):
        assert message in rejected(f"precision {line}")
