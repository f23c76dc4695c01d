"""`barn compare` planners on the same trials, and `barn precision`: worlds needed."""

from pathlib import Path
from typing import Any

import click

from barn_eval.analysis.compare import (
    compare_folders,
    label_groups,
    read_selection,
    read_selections,
)
from barn_eval.analysis.margins import Margin, decide_margin
from barn_eval.analysis.measures import COMPARED, require_measures
from barn_eval.analysis.precision import estimate_precision, figures_table, needs_table
from barn_eval.analysis.tables import comparison_table
from barn_eval.analysis.verdict import conclude_comparison
from barn_eval.commands.options import (
    count_option,
    file_option,
    folder_argument,
    json_option,
    path_argument,
    print_notes,
    print_output,
    progress_bar,
    split_names,
)
from barn_eval.commands.tables import rich_table
from barn_eval.pages.latex import paper_table
from barn_eval.pages.template import write_page
from barn_eval.trials.identity import task_line
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ExitCode


@click.command("compare")
@path_argument("a")
@path_argument("b", required=False)
@click.option(
    "--columns",
    default="",
    show_default=False,
    help="Measures to compare, such as success,challenge.",
)
@file_option(
    "--latex", help="Write a table for a paper, with the best planners in bold."
)
@click.option(
    "--fail-if-worse",
    "margin_texts",
    multiple=True,
    metavar="MEASURE:MARGIN",
    help="Exit with 0 only if the data show that B is worse than A by at most MARGIN. MARGIN is a number, as in"
    " challenge:0.01, or a percentage of A's mean, as in compute_p95_ms:10%; repeatable.",
)
@json_option
def command(
    a: Path,
    b: Path | None,
    columns: str,
    latex: Path | None,
    margin_texts: tuple[str, ...],
    as_json: bool,
) -> int:
    """Compare the planners of A with those of B or, without B, with each other.

    A and B are folders of runs, finished or not. Each can also be a table: a CSV file
    with the columns planner, world, outcome and, if known, repetition and time, or
    out.txt of the BARN Challenge.

    FOLDER:PLANNER,PLANNER selects planners of a folder. If both folders hold several
    planners and you select none, planners of the same name are compared.

    With --fail-if-worse, the exit code is 4 if B is worse than A by more than a margin.
    It is 5 if the data do not show with 95% confidence whether B is worse.
    """
    measures = require_measures(split_names(columns))
    margins = [Margin.parse(text) for text in margin_texts]
    # A margin is judged even if its measure is not among the columns.
    keys = dict.fromkeys(measures or COMPARED)
    keys |= dict.fromkeys(margin.measure for margin in margins)
    with progress_bar("comparing") as progress:
        selections = read_selections(a, b)
        comparisons = compare_folders(
            a, b, keys=list(keys), progress=progress, selections=selections
        )

    if latex is not None:
        write_page(latex, paper_table(label_groups(selections), measures))
        print_notes(latex)

    first = comparisons[0]
    content: list[object] = []
    renderables: list[object] = [task_line(first.protocol, first.task, first.robot)]
    # One pair of planners that is worse decides the exit code of all.
    outcomes: set[str] = set()
    for comparison in comparisons:
        decisions = [decide_margin(comparison, margin) for margin in margins]
        outcomes |= {decision.decision for decision in decisions}
        conclusion = conclude_comparison(comparison)
        content.append(
            as_dict(comparison)
            | {
                "verdict": str(conclusion),
                "decisions": [as_dict(decision) for decision in decisions],
            }
        )
        renderables += conclusion
        if comparison.parameters:
            renderables.append(comparison.parameters)
        renderables += (decision.text for decision in decisions if decision.text)
        renderables.append(rich_table(comparison_table(comparison)))
    print_output(as_json, content, *renderables)

    if "worse" in outcomes:
        return ExitCode.WORSE
    return ExitCode.NOT_SHOWN if "not shown" in outcomes else ExitCode.DONE


_ABOVE_ZERO = click.FloatRange(0.0, min_open=True)


@click.command("precision")
@folder_argument
@click.option(
    "--half-width",
    "width",
    type=_ABOVE_ZERO,
    help="Target half-width of the 95% interval of a mean [default: 5% of the mean].",
)
@click.option(
    "--difference",
    "size",
    type=_ABOVE_ZERO,
    help="Difference between two planners to detect in 8 of 10 runs [default: 5% of the first planner's mean].",
)
@click.option(
    "--measure",
    "measure_key",
    default="",
    show_default=False,
    help="Measure, a column of the results [default: the ranking measure of the protocol].",
)
@count_option("--repetitions", help="Trials per world [default: 1, 2, 3, 5 and 10].")
@json_option
def precision(folder: Path, as_json: bool, **options: Any) -> None:
    """Estimate from the results in FOLDER how many worlds you need to reach a precision.

    FOLDER:PLANNER or FOLDER:PLANNER,PLANNER selects one or two planners. Give values in
    the unit of the measure. For success, give a share, such as 0.05.
    """
    _, rows_by_planner = read_selection(folder)
    estimate = estimate_precision(rows_by_planner, **options)
    # All planners of a run have the same protocol and task.
    row = next(iter(rows_by_planner.values()))[0]
    print_output(
        as_json,
        as_dict(estimate),
        task_line(row.protocol, row.task),
        rich_table(figures_table(estimate)),
        rich_table(needs_table(estimate)),
    )
