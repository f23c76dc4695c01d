"""Measure how large the code is and how easily it reads, by what no formatter changes.

    python qa/checks/house.py
    python qa/checks/house.py --json
    python qa/checks/house.py --worst 20

Rows: each package, all packages together, their tests, and the tools and examples.
`tests/test_house.py` holds the bounds.
"""

import ast
import io
import json
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")
TOOLS = ("qa", "examples")

Function = ast.FunctionDef | ast.AsyncFunctionDef
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
BODIES = {"body", "orelse", "finalbody", "handlers", "cases", "decorator_list"}
DEEP = 5  # nested expressions from which a reader has to take a statement apart

# ruff: noqa: SIM905 (lists of words are easier to read as text)
# Words that say that something happened to a thing, not what it is.
VAGUE = frozenset(
    "found one made told given own asked there shown kept said wanted about others "
    "several chosen here more drawn known seen begun".split()
)
IRREGULAR_PARTICIPLES = frozenset(
    "told made given found kept begun drawn shown seen known said held lost sent taken "
    "chosen written driven gone done met led".split()
)
ENDS_LIKE_A_PARTICIPLE = frozenset("feed seed speed need embed shed bed red".split())
STOP_WORDS = frozenset(
    "the a an of to for in on is are be this that and or which with as by it its from "
    "if value name number object instance used given".split()
)
LAYOUT = {
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.COMMENT,
    tokenize.ENDMARKER,
}
# Python 3.12 and later split an f-string into tokens; earlier ones do not.
FSTRING_START = getattr(tokenize, "FSTRING_START", None)
FSTRING_END = getattr(tokenize, "FSTRING_END", None)


@dataclass
class Counts:
    """What was counted in some files.

    A statement is any but a bare string. `places` are lines that break a rule, as
    "rule file:line".
    """

    tokens: int = 0
    lines: int = 0
    comments: int = 0
    statements: int = 0
    tuples: int = 0
    comprehensions: int = 0
    conditionals: int = 0
    deep: int = 0
    walruses: int = 0
    names: int = 0
    vague: int = 0
    functions: int = 0
    participles: int = 0
    documentable: int = 0
    documented: int = 0
    entries: int = 0
    empty_entries: int = 0
    places: list[str] = field(default_factory=list)

    def add(self, other: "Counts") -> None:
        """Add the counts of other files."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    def figures(self) -> dict[str, float]:
        """Return the figures that bounds are set for, by name."""
        per_thousand = 1000.0 / max(self.statements, 1)
        return {
            "tokens": self.tokens,
            "tuples": self.tuples * per_thousand,
            "comprehensions": self.comprehensions * per_thousand,
            "conditional expressions": self.conditionals * per_thousand,
            "deep expressions": self.deep * per_thousand,
            "walruses": self.walruses * per_thousand,
            "vague names [%]": 100.0 * self.vague / max(self.names, 1),
            "participles [%]": 100.0 * self.participles / max(self.functions, 1),
            "functions with Args [%]": 100.0
            * self.documented
            / max(self.documentable, 1),
            "empty entries [%]": 100.0 * self.empty_entries / max(self.entries, 1),
            "comments [% of all lines]": 100.0 * self.comments / max(self.lines, 1),
        }


def count_file(path: Path) -> Counts:
    """Count one file of Python."""
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    string_lines = lines_of_bare_strings(tree)
    counts = Counts(tokens=count_tokens(text, string_lines))

    lines = text.splitlines()
    counts.lines = len(lines)
    counts.comments = sum(line.lstrip().startswith("#") for line in lines)

    for node in ast.walk(tree):
        count_node(node, counts, path)
    for name, number in bound_names(tree):
        counts.names += 1
        if name.strip("_").split("_")[0] in VAGUE:
            counts.vague += 1
            counts.places.append(f"vague {name} {path.relative_to(ROOT)}:{number}")
    for function in public_functions(tree):
        count_docstring(function, counts, path)
    return counts


def count_node(node: ast.AST, counts: Counts, path: Path) -> None:
    """Count one node of a file's tree.

    Args:
        node: Any node; its children are counted by further calls.
        counts: Counts of the file, which are raised.
        path: The file, for places.
    """
    if isinstance(node, ast.stmt) and not is_bare_string(node):
        counts.statements += 1
        depth = max((nesting(part) for part in header(node)), default=0)
        if depth >= DEEP:
            counts.deep += 1
            counts.places.append(f"deep {path.relative_to(ROOT)}:{node.lineno}")
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Tuple)
            and isinstance(node.value, ast.Tuple)
        ):
            counts.tuples += 1
            counts.places.append(f"tuple {path.relative_to(ROOT)}:{node.lineno}")

    counts.comprehensions += isinstance(node, COMPREHENSIONS)
    counts.conditionals += isinstance(node, ast.IfExp)
    counts.walruses += isinstance(node, ast.NamedExpr)

    if isinstance(node, Function) and not node.name.startswith("__"):
        counts.functions += 1
        if is_participle(node.name) and not is_property(node):
            counts.participles += 1
            place = f"{path.relative_to(ROOT)}:{node.lineno}"
            counts.places.append(f"participle {node.name} {place}")


def count_docstring(function: Function, counts: Counts, path: Path) -> None:
    """Count whether a public function explains its arguments.

    Args:
        function: One that is public; with fewer than two parameters it does not count.
        counts: Counts of the file, which are raised.
        path: The file, for places.
    """
    entries = argument_entries(function)
    if len(entries) < 2:
        return

    counts.documentable += 1
    if None in entries:
        place = f"{path.relative_to(ROOT)}:{function.lineno}"
        counts.places.append(f"undocumented {function.name} {place}")
    else:
        counts.documented += 1
    for entry in entries:
        counts.entries += entry is not None
        counts.empty_entries += entry is False


def count_tokens(text: str, string_lines: set[int]) -> int:
    """Return the number of tokens without layout, comments and bare strings.

    Args:
        text: Content of a file.
        string_lines: Lines that hold docstrings and other bare strings.
    """
    count = 0
    open_fstrings = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        # An f-string counts as one token in every version of Python.
        if token.type == FSTRING_START:
            open_fstrings += 1
            count += open_fstrings == 1
        elif token.type == FSTRING_END:
            open_fstrings -= 1
        elif not open_fstrings and token.type not in LAYOUT:
            count += token.start[0] not in string_lines
    return count


def is_bare_string(node: ast.AST) -> bool:
    """Tell whether a statement is nothing but a string, as docstrings are."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def lines_of_bare_strings(tree: ast.Module) -> set[int]:
    """Return the numbers of the lines that hold docstrings and other bare strings."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and is_bare_string(node):
            lines.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return lines


def header(statement: ast.stmt) -> Iterator[ast.AST]:
    """Yield what a statement consists of, without the statements inside it."""
    for name, value in ast.iter_fields(statement):
        if name in BODIES:
            continue
        parts = value if isinstance(value, list) else [value]
        yield from (part for part in parts if isinstance(part, ast.AST))


def nesting(node: ast.AST) -> int:
    """Return how deep expressions are nested; names and constants do not count."""
    inner = max(map(nesting, ast.iter_child_nodes(node)), default=0)
    is_plain = isinstance(node, ast.Name | ast.Constant | ast.Attribute)
    return inner + (isinstance(node, ast.expr) and not is_plain)


def bound_names(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield every name that a file binds, with its line; classes in lower case."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.alias) and node.asname:
            yield node.asname, node.lineno
        elif isinstance(node, Function | ast.ClassDef | ast.ExceptHandler):
            # An exception handler may have no name.
            words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", node.name or "")
            if words:
                yield words.lower(), node.lineno


def is_participle(name: str) -> bool:
    """Tell whether a function's name begins with a participle."""
    word = name.strip("_").split("_")[0]
    if word in IRREGULAR_PARTICIPLES:
        return True
    return word.endswith("ed") and len(word) > 4 and word not in ENDS_LIKE_A_PARTICIPLE


def is_property(function: Function) -> bool:
    """Tell whether a function is a property of any kind."""
    return any("property" in ast.unparse(line) for line in function.decorator_list)


def public_functions(tree: ast.Module) -> Iterator[Function]:
    """Yield the public functions of a module and its public classes, but commands."""
    nodes: list[ast.stmt] = list(tree.body)
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            nodes += node.body

    for node in nodes:
        if not isinstance(node, Function) or node.name.startswith("_"):
            continue
        decorators = " ".join(map(ast.unparse, node.decorator_list))
        # Click takes the help of a command from its docstring.
        if not re.search("click|command|option|group", decorators):
            yield node


def argument_entries(function: Function) -> list[bool | None]:
    """Return for each parameter whether its entry under Args says something.

    None stands for a missing entry, False for one that repeats name and type.
    """
    docstring = ast.get_docstring(function) or ""
    section = re.search(
        r"(?ms)^\s*Args:\s*\n(.*?)(?=^\s*(?:Returns|Raises|Yields|Example|Note)s?:|\Z)",
        docstring,
    )
    arguments = function.args
    entries: list[bool | None] = []
    for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        if argument.arg in ("self", "cls"):
            continue
        entry = section and re.search(
            rf"(?ms)^\s*\*{{0,2}}{argument.arg}\b[^:\n]*:(.*?)"
            r"(?=^\s*\*{0,2}\w+(?: \([^)]*\))?:|\Z)",
            section[1],
        )
        entries.append(says_something(argument, entry[1]) if entry else None)
    return entries


def says_something(argument: ast.arg, entry: str) -> bool:
    """Tell whether an entry has a word beyond the name and type of its argument.

    Args:
        argument: A parameter with its annotation.
        entry: The text under Args that follows its name.
    """
    annotation = ast.unparse(argument.annotation) if argument.annotation else ""
    signature = f"{argument.arg} {annotation}".lower().replace("_", " ")
    signature_words = set(re.findall("[a-z]+", signature))
    for word in re.findall("[a-z]+", entry.lower()):
        if word in STOP_WORDS or word in signature_words:
            continue
        if word.rstrip("s") not in signature_words:
            return True
    return False


def is_test(path: Path) -> bool:
    """Tell whether a file belongs to tests, helpers and fixtures included."""
    folders = set(path.relative_to(ROOT).parts[:-1])
    return bool({"test", "tests"} & folders) or path.name.startswith("test_")


def sources(folder: str, *, tests: bool) -> Iterator[Path]:
    """Yield the files of Python in a folder of the repository.

    Args:
        folder: Its name at the top of the repository.
        tests: Whether to yield the tests in it, or all else.
    """
    for path in sorted((ROOT / folder).rglob("*.py")):
        if path.name != "setup.py" and is_test(path) == tests:
            yield path


def measure() -> dict[str, Counts]:
    """Return counts by row: packages, all of them, their tests, tools."""
    rows = {name: Counts() for name in (*PACKAGES, "packages", "tests", "tools")}
    for package in PACKAGES:
        for path in sources(f"{package}/{package}", tests=False):
            rows[package].add(count_file(path))
        rows["packages"].add(rows[package])
    for folder in (*PACKAGES, "tests", "qa"):
        for path in sources(folder, tests=True):
            rows["tests"].add(count_file(path))
    for folder in TOOLS:
        for path in sources(folder, tests=False):
            rows["tools"].add(count_file(path))
    return rows


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
@click.option("--worst", type=int, default=0, help="List so many places of each rule.")
def main(as_json: bool, worst: int) -> None:
    """Measure how large the code is and how easily it reads."""
    rows = measure()
    if as_json:
        figures = {name: counts.figures() for name, counts in rows.items()}
        click.echo(json.dumps(figures, indent=1))
        return

    table = Table("per 1000 statements, or as stated", *rows, box=None)
    for name in Counts().figures():
        digits = 0 if name == "tokens" else 1
        values = [counts.figures()[name] for counts in rows.values()]
        table.add_row(name, *(f"{value:,.{digits}f}" for value in values))
    Console(width=160).print(table)

    for rule in ("vague", "participle", "tuple", "deep", "undocumented") * bool(worst):
        places = [place for place in rows["packages"].places if place.startswith(rule)]
        click.echo("\n".join(places[:worst]))


if __name__ == "__main__":
    main()
