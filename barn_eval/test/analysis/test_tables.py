"""The table of results for a paper, in LaTeX."""

import re
import shutil
import subprocess

import pytest
from analysis.test_compare import results
from refusals import refused

import barn_eval as barn
from barn_eval.pages.latex import paper_table


def cells(text):
    """The cells of each row by the planner's name."""
    rows = [
        row.split(" & ") for row in re.findall(r"^\{\}(.*) \\\\$", text, re.MULTILINE)
    ]
    return {name: figures for name, *figures in rows}


def test_the_best_and_what_is_not_clearly_worse_is_bold():
    fast = results(worlds=20)
    even = results("twin", worlds=20)
    slow = results("eband", slower_s=5.0, worlds=20)
    bold_cells = cells(
        paper_table(
            {"fast": fast, "twin": even, "slow": slow}, ["normalised_time_s_per_m"]
        )
    )
    assert {name: r"\textbf" in cell for name, (cell,) in bold_cells.items()} == {
        "fast": True,
        "twin": True,
        "slow": False,
    }
    # Where nothing is significant, nothing is bold.
    groups = {"fast": fast, "twin": even}
    bold_cells = cells(paper_table(groups, ["normalised_time_s_per_m"]))
    assert not any(r"\textbf" in cell for (cell,) in bold_cells.values())
    bold_cells = cells(paper_table({"fast": fast}, ["normalised_time_s_per_m"]))
    assert r"\textbf" not in bold_cells["fast"][0]


def test_figures_are_those_of_the_trials_that_all_have():
    whole = results(worlds=20)
    part = [row for row in results("eband", worlds=20) if row.world < 12]
    text = paper_table({"a": whole, "b": part})
    assert "over 12 worlds of" in text
    shared = [row for row in whole if row.world < 12]
    assert cells(text)["a"][1].startswith(
        cells(paper_table({"a": shared, "b": part}))["a"][1]
    )


def test_columns_caption_and_label_are_chosen_and_names_are_text(folder):
    columns = ["success", "traversal_time_s", "mean_speed_mps"]
    text = barn.load(folder).latex(columns, caption="50% of a_b", label="tab:mine")
    assert r"\caption{50\% of a\_b}" in text and r"\label{tab:mine}" in text
    headings = r"planner & success [\%] $\uparrow$ & time of successes [s] $\downarrow$ & mean speed [m/s] \\"
    assert headings in text
    hostile = paper_table({r"\input{x} & [": results(worlds=4)})
    assert r"{}\textbackslash{}input\{x\} \& [" in hostile
    for label in ("a}b", "", "a b"):
        with refused("label: must have letters"):
            paper_table({"a": results(worlds=4)}, label=label)
    with refused("unknown measure 'succes'; did you mean 'success'"):
        barn.load(folder).latex(["succes"])


def test_the_command_writes_the_table_that_it_prints(folder, tmp_path, command):
    code, output, _ = command(
        f"compare {folder} --columns success,contact_s --latex {tmp_path}/t.tex"
    )
    text = (tmp_path / "t.tex").read_text()
    assert code == 0 and text == barn.load(folder).latex(["success", "contact_s"])
    assert [name in output for name in ("success", "contact", "jerk")] == [
        True,
        True,
        False,
    ]


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="pdflatex is not installed")
def test_latex_takes_the_table(folder, tmp_path):
    head = r"\documentclass{article}\usepackage{booktabs}\begin{document}"
    (tmp_path / "t.tex").write_text(
        head + "\n" + barn.load(folder).latex() + r"\end{document}" + "\n"
    )
    done = subprocess.run(
        ["pdflatex", "-halt-on-error", "t.tex"],
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout.decode()[-500:]
