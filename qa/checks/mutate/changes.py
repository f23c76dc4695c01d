"""Small changes to a Python source, each of which a unit test should notice.

Changed are comparisons, arithmetic, boolean connectives, conditions, constants, return
values, neighboring arguments and names that are easily confused; statements are
removed. Left alone are docstrings, annotations, type aliases, decorators, imports,
f-strings and what an error says: they decide no result.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import singledispatch
from itertools import pairwise
from typing import Any, TypeGuard

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Mod: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
CONFUSED = {
    "x": "y",
    "linear": "angular",
    "odometry": "truth",
    "low": "high",
    "left": "right",
    "first": "last",
    "min": "max",
    "minimum": "maximum",
    "any": "all",
    "cos": "sin",
    "a": "b",
    "start": "goal",
    "_first": "_last",
    "traversal_time_s": "duration_s",
    "mean": "sum",
    "larger": "smaller",
}
NAMES = CONFUSED | {b: a for a, b in CONFUSED.items()}
SYMMETRIC = {"hypot", "min", "max", "minimum", "maximum", "isclose"}

# what to replace of the source, and by which text
Change = tuple[ast.expr | ast.stmt, str]


@dataclass(frozen=True)
class Mutant:
    """One change to a source: its place, what it replaces and the text after it."""

    where: str
    line: int
    was: str
    now: str
    text: str


def mutants_of(source: str) -> list[Mutant]:
    """Return every change to a module's source in the order of its lines.

    No change is there twice.
    """
    whole = source.encode()
    lines = whole.splitlines(keepends=True)
    starts = [sum(map(len, lines[:row])) for row in range(len(lines) + 1)]
    mutants: dict[str, Mutant] = {}
    for node, where in _nodes(ast.parse(source), ""):
        for place, change in (*changes(node), *_removal(node)):
            top = place.lineno - 1
            bottom = place.end_lineno or place.lineno
            begin = starts[top] + place.col_offset
            end = starts[bottom - 1] + (place.end_col_offset or 0)
            before = whole[:begin]
            after = change.encode() + whole[end:]
            was = whole[starts[top] : starts[bottom]]
            now = (before[starts[top] :] + after)[
                : len(was) + len(change.encode()) - (end - begin)
            ]
            text = (before + after).decode()
            mutants[text] = Mutant(
                where, top + 1, _join_lines(was), _join_lines(now), text
            )
    mutants.pop(source, None)
    return sorted(mutants.values(), key=lambda mutant: mutant.line)


def _join_lines(text: bytes) -> str:
    return " ".join(text.decode().split())


def _nodes(node: ast.AST, where: str) -> Iterator[tuple[ast.AST, str]]:
    """Yield each node that may change and the dotted name of its function or class."""
    match node:
        case (
            ast.Import()
            | ast.ImportFrom()
            | ast.JoinedStr()
            | ast.Expr(value=ast.Constant())
        ):
            return
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return
        case ast.Assign(targets=[ast.Name(id=name)]) if not where and re.match(
            "[A-Z][a-z]", name
        ):
            return
    yield node, where
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        where = f"{where}.{node.name}".lstrip(".")
    for child in _children(node):
        yield from _nodes(child, where)


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of a node without decorators, annotations and texts of errors."""
    if isinstance(node, ast.FunctionDef):
        yield from (
            default
            for default in (*node.args.defaults, *node.args.kw_defaults)
            if default
        )
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        yield from node.body
    elif isinstance(node, ast.AnnAssign):
        yield from [node.value] if node.value else []
    elif not isinstance(node, ast.Raise):
        yield from ast.iter_child_nodes(node)


@singledispatch
def changes(_node: ast.AST) -> list[Change]:
    """Return the changes to a node."""
    return []


@changes.register
def _(node: ast.Compare) -> list[Change]:
    compare_changes = _keys([node.left, *node.comparators])
    for index, operator in enumerate(node.ops):
        for other in COMPARISONS[type(operator)]:
            ops = [*node.ops[:index], other(), *node.ops[index + 1 :]]
            comparison = ast.Compare(node.left, ops, node.comparators)
            compare_changes.append((node, _text(comparison)))
    return compare_changes


@changes.register
def _(node: ast.BinOp) -> list[Change]:
    if isinstance(node.op, ast.MatMult):
        sides = [node.right, node.left]
        return (
            []
            if _text(sides[0]) == _text(sides[1])
            else [(node, _text(ast.BinOp(sides[0], node.op, sides[1])))]
        )
    operator = OPERATORS[type(node.op)]()
    return [(node, _text(ast.BinOp(node.left, operator, node.right)))]


@changes.register
def _(node: ast.AugAssign) -> list[Change]:
    operator = OPERATORS[type(node.op)]()
    change = ast.AugAssign(node.target, operator, node.value)
    return [(node, ast.unparse(change))]


@changes.register
def _(node: ast.BoolOp) -> list[Change]:
    operator = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    return [(node, _text(ast.BoolOp(operator, node.values)))]


@changes.register
def _(node: ast.UnaryOp) -> list[Change]:
    return [(node, _text(node.operand))]


@changes.register
def _(node: ast.Constant) -> list[Change]:
    near: list[object] = []
    if isinstance(node.value, bool):
        near = [not node.value]
    elif isinstance(node.value, int):
        near = [node.value - 1, node.value + 1]
    elif isinstance(node.value, float):
        near = (
            [float(f"{factor * node.value:.6g}") for factor in (0.9, 1.1)]
            if node.value
            else [-0.1, 0.1]
        )
    elif node.value in NAMES:
        near = [NAMES[node.value]]
    return [(node, repr(value)) for value in near]


@changes.register
def _(node: ast.Name) -> list[Change]:
    return (
        [(node, NAMES[node.id])]
        if isinstance(node.ctx, ast.Load) and node.id in NAMES
        else []
    )


@changes.register
def _(node: ast.Attribute) -> list[Change]:
    confused = isinstance(node.ctx, ast.Load) and node.attr in NAMES
    return [(node, f"{_text(node.value)}.{NAMES[node.attr]}")] if confused else []


@changes.register
def _(node: ast.Call) -> list[Change]:
    if getattr(node.func, "attr", getattr(node.func, "id", "")) in SYMMETRIC:
        return []
    swaps: list[Change] = []
    for first, second in pairwise(node.args):
        are_texts = _is_text(first) and _is_text(second)
        if _text(first) != _text(second) and not are_texts:
            both = ast.Tuple([first, second], **_span(first, second))
            swaps.append((both, f"{_text(second)}, {_text(first)}"))
    return swaps


@changes.register(ast.If)
@changes.register(ast.IfExp)
@changes.register(ast.While)
def _(node: ast.If | ast.IfExp | ast.While) -> list[Change]:
    return _opposite(node.test)


@changes.register
def _(node: ast.comprehension) -> list[Change]:
    return [change for condition in node.ifs for change in _opposite(condition)]


@changes.register
def _(node: ast.Return) -> list[Change]:
    return [(node, "return None")] if node.value else []


@changes.register
def _(node: ast.keyword) -> list[Change]:
    return _keys([node.value])


@changes.register
def _(node: ast.Subscript) -> list[Change]:
    return _keys([node.slice])


@changes.register
def _(node: ast.Dict) -> list[Change]:
    return _keys([*node.keys, *node.values])


@changes.register(ast.Tuple)
@changes.register(ast.List)
@changes.register(ast.Set)
def _(node: ast.Tuple | ast.List | ast.Set) -> list[Change]:
    return _keys(node.elts)


def _keys(parts: list[ast.expr] | list[ast.expr | None]) -> list[Change]:
    """Return changes to texts that are keys or choices, not words for a reader."""
    return [(part, repr(str(part.value) + "_")) for part in parts if _is_text(part)]


def _opposite(condition: ast.expr) -> list[Change]:
    """Return the opposite of a condition.

    It is left out where a change to the condition itself gives it.
    """
    return (
        []
        if isinstance(condition, (ast.Compare, ast.UnaryOp))
        else [(condition, f"(not {_text(condition)})")]
    )


def _removal(node: ast.AST) -> list[Change]:
    """Return the removal of a statement that acts on more than a local name."""
    match node:
        case (
            ast.Expr()
            | ast.AugAssign()
            | ast.Raise()
            | ast.Continue()
            | ast.Break()
            | ast.Return(value=None)
        ):
            return [(node, "pass")]
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            return [(node, "pass")]
    return []


def _is_text(node: ast.expr | None) -> TypeGuard[ast.Constant]:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _span(first: ast.expr, last: ast.expr) -> dict[str, Any]:
    """Return the place of neighboring expressions as the attributes of a node."""
    begin = {"lineno": first.lineno, "col_offset": first.col_offset}
    return begin | {
        "end_lineno": last.end_lineno,
        "end_col_offset": last.end_col_offset,
    }


def _text(node: ast.expr) -> str:
    """Return an expression as text that may stand anywhere."""
    plain = isinstance(
        node,
        (ast.Name, ast.Attribute, ast.Call, ast.Constant, ast.Starred, ast.Subscript),
    )
    return ast.unparse(node) if plain else f"({ast.unparse(node)})"
