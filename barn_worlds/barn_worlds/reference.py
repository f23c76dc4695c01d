"""The tables of parameters in the READMEs and the files for `--params-file`, made from the configurations themselves.

Each package lists its tables and files in a module `reference`. `tools/regenerate.py` writes them, and a test in each
package checks that they are current.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from barn_worlds.config import fields_of

_NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Reference:
    """The generated parts of a package: sections of README.md and files in the folder config.

    sections: Markdown by the NAME in `<!-- NAME: begin -->` and `<!-- NAME: end -->`. files: parameter files by name.
    """

    sections: Mapping[str, str]
    files: Mapping[str, str]

    def contents(self, package: Path) -> dict[Path, str]:
        """Return the content that each file should have; ValueError if the README lacks a marker."""
        readme = package / "README.md"
        text = readme.read_text("utf-8")
        for name, section in self.sections.items():
            begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
            before, found, rest = text.partition(begin)
            _, closed, after = rest.partition(end)
            if not found or not closed:
                raise ValueError(f"{readme}: lacks {begin} ... {end}")
            text = f"{before}{begin}\n\n{section}\n\n{end}{after}"
        return {readme: text} | {package / "config" / name: text for name, text in self.files.items()}

    def write(self, package: Path) -> None:
        """Write the files."""
        for path, text in self.contents(package).items():
            path.write_text(text, "utf-8")

    def outdated(self, package: Path) -> list[str]:
        """Return the files that are not current, and parameter files that should not exist."""
        contents = self.contents(package)
        kept = {path: path.read_text("utf-8") for path in (package / "README.md", *package.glob("config/*.yaml"))}
        return sorted(path.name for path in {*contents, *kept} if contents.get(path) != kept.get(path))


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def parameter_table(columns: Mapping[str, Any], leave_out: Collection[str] = ()) -> str:
    """Return a Markdown table of parameters; columns: configurations of one class by heading."""
    values = [{name: value for name, _, value in fields_of(config)} for config in columns.values()]
    rows = [
        [f"`{name}`", *(_cell(config[name]) for config in values), about.unit, about.text(unit=False)]
        for name, about, _ in fields_of(next(iter(columns.values())))
        if name not in leave_out
    ]
    return table(["parameter", *columns, "unit", "meaning"], rows)


def parameter_file(
    node: str, title: str, configs: Sequence[Any], first: Mapping[str, Any] = _NOTHING, leave_out: Collection[str] = ()
) -> str:
    """Return a file with all parameters of a node, each with its meaning.

    node: which nodes it is for, such as "/**/simulator" (that node in any namespace). first: parameters that are in no
    configuration. A parameter that is in two of them has the value of the last.
    """
    found = {name: (about, value) for config in configs for name, about, value in fields_of(config)}
    lines = [f"# {title}", f"{node}:", "  ros__parameters:"]
    lines += [f"    {_entry(name, value)}" for name, value in first.items()]
    for name, (about, value) in found.items():
        if name not in leave_out:
            lines += [f"    # {about.text()}", f"    {_entry(name, value)}"]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_cell, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _entry(name: str, value: Any) -> str:
    if isinstance(value, tuple):
        return f"{name}: {yaml.safe_dump(list(value), default_flow_style=True, width=1000).strip()}"
    return yaml.safe_dump({name: value}, width=1000).strip()
