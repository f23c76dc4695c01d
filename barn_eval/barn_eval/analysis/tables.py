"""Tables of a report as text in cells, for the page and as CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.difficulty import Band
from barn_eval.analysis.sources import Entry
from barn_metrics.bootstrap import Interval, number

_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{character: f"\\{character}" for character in "#$%&_"},
}


@dataclass(frozen=True)
class Table:
    """A table: `name` is that of its files; the first column, or as many as `texts`, hold texts, the others figures."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int = 1

    def csv(self) -> str:
        """Return the table as CSV with a head."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns, *self.rows])
        return buffer.getvalue()

    def latex(self) -> str:
        """Return the table as a LaTeX tabular for the package booktabs."""
        # The braces keep a row that begins with a bracket or a star from being an option of the line's end before it.
        lines = ["{}" + " & ".join(map(latex_text, row)) + r" \\" for row in (self.columns, *self.rows)]
        head = rf"\begin{{tabular}}{{{'l' * self.texts}{'r' * (len(self.columns) - self.texts)}}}"
        return "\n".join(
            [f"% {one_line(self.title)}", head, r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule"]
            + [r"\end{tabular}", ""]
        )


def latex_text(text: str) -> str:
    """Return a text in which nothing is a command of LaTeX, and a number's minus is one."""
    escaped = "".join(_LATEX.get(character, character) for character in one_line(text))
    return re.sub(r"(?<![\w.-])-(?=\d)", "$-$", escaped)


def one_line(text: str) -> str:
    """Return a text without line breaks and control characters."""
    return re.sub(r"[\x00-\x1f\x7f\u2028\u2029]+", " ", text)


def difference(interval: Interval, digits: int = 3) -> str:
    """Return a difference with its limits, marked * where they leave out zero."""
    return interval.text(digits) + (" *" if interval.excludes(0.0) else "")


def bands_table(entries: Sequence[Entry], found: Sequence[Band]) -> Table:
    """Return success and time of each entry in each band."""
    rows = [
        (
            "{} ({} worlds, {:.2f} to {:.2f} s/m)".format(band.name, len(band.worlds), *band.limits_s_per_m),
            entry.label,
            str(row.trials),
            row.success_rate.scaled(100.0).text(1),
            row.success_time_s.text(),
            row.normalised_time_s_per_m.text(),
        )
        for band in found
        for entry, row in zip(entries, band.rows, strict=True)
    ]
    columns = ("band", "planner", "trials", "success [%]", "time of successes [s]", "time per metre as counted [s/m]")
    return Table("bands", "Success and time by difficulty band, 95 % intervals", columns, tuple(rows), texts=2)


def comparison_table(found: Comparison, name: str) -> Table:
    """Return the comparison of two entries."""
    rows = [
        (
            f"{row.measure} [{row.unit}]" if row.unit else row.measure,
            number(row.paired.mean_a, 3),
            number(row.paired.mean_b, 3),
            difference(row.paired.difference),
            row.paired.improvement.text(3),
            str(row.paired.trials),
        )
        for row in found.rows
    ]
    columns = ("measure", found.a, found.b, "difference", f"P({found.a} is better)", "pairs of trials")
    return Table(name, f"{found.a} against {found.b} on the same worlds and seeds", columns, tuple(rows))
