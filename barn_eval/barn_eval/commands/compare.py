"""`barn compare`, planners on the same worlds and seeds, and `barn precision`, how many worlds that needs."""

from pathlib import Path

import click

from barn_eval.analysis.compare import compare_folders, read_groups, read_selection
from barn_eval.analysis.margins import Margin, decide_margin
from barn_eval.analysis.measures import COMPARED, require_measures
from barn_eval.analysis.precision import estimate_precision as precision_of
from barn_eval.analysis.precision import (
    figures_table,
    needs_table,
)
from barn_eval.analysis.ranking_power import ranking_power, ranking_table
from barn_eval.analysis.tables import comparison_table, paper_table
from barn_eval.analysis.verdict import conclude_comparison
from barn_eval.commands.options import (
    COUNT,
    FILE,
    PATH,
    json_option,
    keys_of,
    progress,
    say,
    tell,
)
from barn_eval.commands.tables import rich_table
from barn_eval.pages.template import write_page
from barn_eval.trials.identity import task_line
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError


@click.command("compare")
@click.argument("a", type=PATH)
@click.argument("b", type=PATH, required=False)
@click.option(
    "--columns",
    default="",
    show_default=False,
    help="Measures, such as success,challenge.",
)
@click.option(
    "--latex",
    type=FILE,
    help="Write the planners as a table of a paper, the best in bold.",
)
@click.option(
    "--fail-if-worse",
    "margins",
    multiple=True,
    metavar="MEASURE:MARGIN",
    help="End with exit code 0 only if B is shown to be worse than A by no more than this, such as challenge:0.01 or"
    " compute_p95_ms:10% of A's mean; repeatable.",
)
@json_option
def command(
    a: Path,
    b: Path | None,
    columns: str,
    latex: Path | None,
    margins: tuple[str, ...],
    as_json: bool,
) -> int:
    """Compare A with B: folders of experiments, finished or not. Without B, the planners of A with each other.

    FOLDER:PLANNER chooses one of several planners, FOLDER:PLANNER,PLANNER some. Where both folders hold several and
    none is chosen, planners of the same name are compared.

    With --fail-if-worse, the exit code is 4 if B is worse than A by more than a margin, 5 if that is neither shown nor
    ruled out at 95 %.
    """
    keys, wanted = (
        require_measures(keys_of(columns)),
        [Margin.parse(one) for one in margins],
    )
    with progress("comparing") as share:
        compared = dict.fromkeys(
            (*(keys or COMPARED), *(one.measure for one in wanted))
        )
        found = compare_folders(a, b, keys=list(compared), progress=share)
    decided = [[decide_margin(one, margin) for margin in wanted] for one in found]
    if latex is not None:
        write_page(latex, paper_table(read_groups(a, b), keys))
        say(latex)
    content: list[object] = []
    shown: list[object] = [task_line(found[0].protocol, found[0].task, found[0].robot)]
    for one, own in zip(found, decided, strict=True):
        said = conclude_comparison(one)
        content.append(
            as_dict(one) | {"verdict": str(said), "decisions": list(map(as_dict, own))}
        )
        texts = filter(None, (one.parameters, *(each.text for each in own)))
        shown += [*said, *texts, rich_table(comparison_table(one))]
    tell(as_json, content, *shown)
    kinds = {each.decision for own in decided for each in own}
    return 4 if "worse" in kinds else 5 if "not shown" in kinds else 0


_ABOVE_ZERO = click.FloatRange(0.0, min_open=True)


@click.command("precision")
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option(
    "--half-width",
    type=_ABOVE_ZERO,
    help="Half the 95 % interval wanted of a mean [default: 5 % of it].",
)
@click.option(
    "--difference",
    type=_ABOVE_ZERO,
    help="Difference of two planners to be found 8 times in 10 [default: 5 % of the first one's mean].",
)
@click.option(
    "--measure",
    "measures",
    multiple=True,
    help="A column of the results, with --ranking repeatable [default: the metric of the protocol].",
)
@click.option(
    "--repetitions", type=COUNT, help="Trials per world [default: 1, 2, 3, 5 and 10]."
)
@click.option(
    "--ranking",
    is_flag=True,
    help="Say how many worlds bring planners into the right order; many FOLDERS.",
)
@json_option
def precision(
    folders: tuple[Path, ...],
    half_width: float | None,
    difference: float | None,
    measures: tuple[str, ...],
    repetitions: int | None,
    ranking: bool,
    as_json: bool,
) -> None:
    """Say how many worlds a wanted precision needs, from the results in FOLDERS, one unless --ranking is given.

    FOLDER:PLANNER, or FOLDER:PLANNER,PLANNER, chooses one or two of several planners. Wanted values are in the unit of
    the measure, of success as a share such as 0.05.
    """
    if ranking:
        powers = [
            one
            for folder in folders
            for one in ranking_power(read_selection(folder)[1], measures)
        ]
        tell(as_json, list(map(as_dict, powers)), rich_table(ranking_table(powers)))
        return
    if len(folders) > 1 or len(measures) > 1:
        raise ConfigError("only --ranking takes several folders or measures")
    _, results = read_selection(folders[0])
    found = precision_of(
        results,
        half_width,
        difference,
        measure_key="".join(measures),
        repetitions=repetitions,
    )
    first = next(iter(results.values()))[0]
    tables = map(rich_table, (figures_table(found), needs_table(found)))
    tell(as_json, as_dict(found), task_line(first.protocol, first.task), *tables)
