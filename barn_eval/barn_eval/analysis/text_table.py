"""A table of texts: on the terminal, in a page, as CSV, LaTeX and Markdown."""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

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
class TextTable:
    """A table: `name` is that of its files; the first column, or as many as `texts`, hold texts, the others figures."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int = 1
    caption: str = ""

    def csv(self) -> str:
        """Return the table as CSV with a head."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns, *self.rows])
        return buffer.getvalue()

    def latex(self) -> str:
        """Return the table as a LaTeX tabular for the package booktabs."""
        # The braces keep a row that begins with a bracket or a star from being an option of the line's end before it.
        lines = [
            "{}" + " & ".join(map(latex_text, row)) + r" \\"
            for row in (self.columns, *self.rows)
        ]
        head = rf"\begin{{tabular}}{{{'l' * self.texts}{'r' * (len(self.columns) - self.texts)}}}"
        return "\n".join(
            [
                f"% {one_line(self.title)}",
                head,
                r"\toprule",
                lines[0],
                r"\midrule",
                *lines[1:],
                r"\bottomrule",
            ]
            + [r"\end{tabular}", ""]
        )


def latex_text(text: str) -> str:
    """Return a text in which nothing is a command of LaTeX, and a number's minus is one."""
    escaped = "".join(_LATEX.get(character, character) for character in one_line(text))
    return re.sub(r"(?<![\w.-])-(?=\d)", "$-$", escaped)


def counted(number: int, noun: str) -> str:
    """Return a number of things, such as "1 trial" or "2 trials"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def joined(names: Sequence[str], word: str = "and") -> str:
    """Return names as a sentence lists them, such as "a, b and c"."""
    return f" {word} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def one_line(text: str) -> str:
    """Return a text without line breaks and control characters."""
    return re.sub(r"[\x00-\x1f\x7f\u2028\u2029]+", " ", text)
