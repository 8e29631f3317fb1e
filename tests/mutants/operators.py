"""Small changes of a module's source, one at a time: what a test of the module should detect."""

from __future__ import annotations

import ast
import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from types import CodeType
from typing import Any

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
ARITHMETIC: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub, ast.Mult),
    ast.Sub: (ast.Add, ast.Mult),
    ast.Mult: (ast.Div, ast.Add),
    ast.Div: (ast.Mult, ast.Sub),
    ast.Pow: (ast.Mult, ast.Add),
    ast.MatMult: (ast.Mult,),
    ast.BitOr: (ast.BitAnd,),
}
CALLS = {"min": "max", "max": "min", "all": "any", "any": "all"}
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
NEVER_RUN = ("annotation", "returns", "type_comment")
"""Fields of a node that ``from __future__ import annotations`` leaves unevaluated."""
FORM = ("slots", "kw_only")
"""Arguments of a dataclass that no program's behaviour depends on."""
READABLE = 100
"""Maximum length of the text that shows a change."""


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One change: its place, its text before and after, and the changed module."""

    place: str
    before: str
    after: str
    inside: bool
    """Whether the change is in a function's body: then the rest of the module stays as it is."""
    code: CodeType

    @property
    def name(self) -> str:
        """Name without a line number: it stays the same when other lines move."""
        return f"{self.place}: {self.before} -> {self.after}"


@dataclass(frozen=True, slots=True)
class _Spot:
    """A node, the field of its parent that has it, and the nodes above."""

    node: ast.AST
    above: tuple[ast.AST, ...]
    field: str
    index: int | None
    place: str
    inside: bool

    def put(self, node: Any) -> None:
        if self.index is None:
            setattr(self.above[-1], self.field, node)
        else:
            getattr(self.above[-1], self.field)[self.index] = node

    def shown(self) -> ast.AST:
        """Return what shows the change best: the largest short expression around the node, else its statement."""
        nodes = [self.node, *reversed(self.above)]
        for number, (node, parent) in enumerate(itertools.pairwise(nodes)):
            text = len(ast.unparse(parent)) if isinstance(parent, ast.expr) else 0
            if number and (isinstance(node, ast.stmt) or not isinstance(parent, ast.expr) or text > READABLE):
                return node
        return self.node


def mutants(source: str, filename: str) -> Iterator[Mutant]:
    """Yield the mutants of a module, in the order of its lines."""
    tree = ast.parse(source)
    seen: Counter[str] = Counter()
    for spot in list(_spots(tree, (), "", False)):
        for changed in _changes(spot):
            statement = isinstance(spot.node, ast.stmt)
            shown = spot.node if statement else spot.shown()
            before = _text(shown)
            spot.put(ast.copy_location(changed, spot.node))
            try:
                after = _text(changed if shown is spot.node else shown)
                code = compile(ast.fix_missing_locations(tree), filename, "exec", dont_inherit=True)
            finally:
                spot.put(spot.node)
            seen[f"{spot.place} {before} {after}"] += 1
            count = seen[f"{spot.place} {before} {after}"]
            after = after if count == 1 else f"{after} ({count})"
            yield Mutant(place=spot.place, before=before, after=after, inside=spot.inside, code=code)


def _text(node: ast.AST) -> str:
    if isinstance(node, (ast.If, ast.While)):
        return f"{type(node).__name__.lower()} {_text(node.test)}"
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= READABLE else f"{text[: READABLE - 4]} ..."


def _spots(parent: ast.AST, above: tuple[ast.AST, ...], place: str, inside: bool) -> Iterator[_Spot]:
    above = (*above, parent)
    for field, value in ast.iter_fields(parent):
        if field in NEVER_RUN:
            continue
        inner = inside or (isinstance(parent, FUNCTIONS) and field == "body")
        for index, node in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if not isinstance(node, ast.AST) or isinstance(node, (ast.Import, ast.ImportFrom)):
                continue
            if _is_docstring(node) or (isinstance(node, ast.keyword) and node.arg in FORM):
                continue
            yield _Spot(node, above, field, index, place or "module", inner)
            name = f"{place}.{node.name}".lstrip(".") if isinstance(node, SCOPES) else place
            yield from _spots(node, above, name, inner)


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _changes(spot: _Spot) -> Iterator[ast.AST]:
    node = spot.node
    match node:
        case ast.Compare(left=left, ops=[op], comparators=right):
            for other in COMPARISONS[type(op)]:
                yield ast.Compare(left=left, ops=[other()], comparators=right)
        case ast.BinOp(left=left, op=operator, right=last):
            for arithmetic in ARITHMETIC.get(type(operator), ()):
                yield ast.BinOp(left=left, op=arithmetic(), right=last)
        case ast.BoolOp(op=junction, values=values):
            yield ast.BoolOp(op=ast.Or() if isinstance(junction, ast.And) else ast.And(), values=values)
            for number in range(len(values)):
                rest = values[:number] + values[number + 1 :]
                yield rest[0] if len(rest) == 1 else ast.BoolOp(op=junction, values=rest)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.Constant(value=value):
            yield from _other_constants(value, spot)
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test) if not _has_opposite(test):
            yield type(node)(**{**dict(ast.iter_fields(node)), "test": _negated(test)})
        case ast.comprehension(ifs=[first, *others]) if not _has_opposite(first):
            yield ast.comprehension(node.target, node.iter, [_negated(first), *others], node.is_async)
        case ast.Call(func=ast.Name(id=name)) if name in CALLS:
            yield ast.Call(ast.Name(CALLS[name], ast.Load()), node.args, node.keywords)
        case ast.Return(value=returned) if returned is not None and not _is_none(returned):
            yield ast.Return(ast.Constant(None))
        case ast.Return() if _ends_function(spot):
            pass
        case ast.Continue():
            yield ast.Break()
        case ast.Break():
            yield ast.Continue()
        case ast.Expr() | ast.Assign() | ast.AugAssign() | ast.Raise() | ast.Delete() | ast.Return() if spot.inside:
            yield ast.Pass()
        case _:
            pass


def _other_constants(value: object, spot: _Spot) -> Iterator[ast.AST]:
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int):
        yield ast.Constant(value + 1)
        yield ast.Constant(value - 1)
    elif isinstance(value, float):
        yield ast.Constant(value * 2.0 if value else 1.0)
        yield ast.Constant(value * 0.5 if value else -1.0)
    elif isinstance(value, str) and spot.inside and value:
        yield ast.Constant(f"{value}?")


def _ends_function(spot: _Spot) -> bool:
    """Return whether a ``return None`` is a function's last statement, which does nothing."""
    parent = spot.above[-1]
    return isinstance(parent, FUNCTIONS) and isinstance(parent.body, list) and spot.node is parent.body[-1]


def _has_opposite(test: ast.expr) -> bool:
    """Return whether one of the other changes of a condition is its opposite."""
    return isinstance(test, ast.Compare) or (isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not))


def _negated(test: ast.expr) -> ast.expr:
    return ast.UnaryOp(ast.Not(), test)


def _is_none(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value is None
