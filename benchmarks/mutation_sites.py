"""What can be mutated in a source file: every site with its mutants, found in the syntax tree.

A mutant is one small change of the code that a programmer could have made by mistake. Left out by rule, since no test
should have to notice: docstrings and all other texts, annotations, decorators, what a `raise` or an `assert` says,
`__all__`, blocks that only type checkers read, protocols (they have no code), calls that only tell somebody something
(progress, prints, warnings), the order of what commutes, detaching where there are no gradients, and arguments that
decide nothing here (a zip's `strict`, a device where there is one).
"""

from __future__ import annotations

import ast
import copy
import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

# What replaces a comparison: its boundary moved, and its opposite.
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
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div, ast.Add),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.BitXor: (ast.BitAnd,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.MatMult: (),
}
# A function that is called, and what is called in its place.
_PAIRS = (
    ("min", "max"), ("amin", "amax"), ("argmin", "argmax"), ("minimum", "maximum"), ("fmin", "fmax"), ("floor", "ceil"),
    ("any", "all"), ("sum", "mean"), ("sin", "cos"), ("exp", "log"), ("cumsum", "cumprod"), ("zeros", "ones"),
    ("zeros_like", "ones_like"), ("isfinite", "isnan"), ("square", "abs"),
)  # fmt: skip
PARTNERS = {**dict(_PAIRS), **{other: one for one, other in _PAIRS}, "median": "mean", "sqrt": "square"}
# Methods that give a changed version of what they are called on: a mutant calls nothing.
REMOVABLE = {
    "abs", "clamp", "clamp_", "clip", "clone", "copy", "detach", "exp", "flip", "log", "neg", "nan_to_num",
    "relu", "reversed", "sigmoid", "sorted", "sqrt", "square", "strip", "tanh", "t", "round",
}  # fmt: skip
# Calls that tell somebody something, and decide nothing.
TELLING = {"print", "warn", "progress", "debug", "info", "warning", "stage", "silent"}
_NOT_CODE = {"InputError", "TypeVar", "cast", "Literal"}  # calls that make a message or a type
# The order of two arguments that decides nothing: of what commutes, and of a value and its lower bound.
_COMMUTES = {
    "allclose", "clip", "equal", "gcd", "hypot", "isclose", "logical_and", "logical_or", "max", "maximum", "min",
    "minimum",
}  # fmt: skip
# Arguments that decide nothing where all goes well on a machine with one device: `strict` of a zip says what is known.
_IDLE_ARGUMENTS = {"device", "memory_format", "non_blocking", "strict", "copy", "stacklevel"}


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    id: says what is changed, not where the line stands, so that it stays the same while other lines come and go. line,
    end: the lines of the smallest statement that is changed, counted from 1. name: of the outermost function around it,
    "" where it runs at import. before, after: code on one line. mentioned: names to which the statement gives a value.
    site: begin and end of what is replaced, in bytes. replacement: what stands there instead.
    """

    id: str
    file: str
    line: int
    end: int
    name: str
    operator: str
    before: str
    after: str
    mentioned: tuple[str, ...]
    site: tuple[int, int]
    replacement: str

    def applied(self, text: str) -> str:
        """The file's text with this change."""
        begin, stop = self.site
        raw = text.encode()
        return (raw[:begin] + self.replacement.encode() + raw[stop:]).decode()


@dataclass(frozen=True)
class _Place:
    """Where the walk is: the enclosing function and class, and the statement."""

    function: str
    qualified: str
    statement: ast.stmt
    mentioned: tuple[str, ...]


def mutants_of(root: Path, file: str) -> list[Mutant]:
    """Every mutant of a file, in the order of the text. file: its path below the root."""
    raw = (root / file).read_bytes()
    starts = [0]
    for line in raw.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Mutant] = []
    seen: dict[str, int] = {}
    for place, node, operator, new in _changes(ast.parse(raw)):
        if ast.dump(node) == ast.dump(new):
            continue
        begin, stop = _span(node, starts)
        first, last = _span(place.statement, starts)
        before, after = " ".join(raw[begin:stop].decode().split()), _text(new)
        statement = hashlib.sha256(raw[first:last]).hexdigest()
        # Identical changes of identical statements of one function are told apart by their order.
        key = "\n".join((file, place.qualified, statement, operator, before, after))
        seen[key] = seen.get(key, 0) + 1
        mark = hashlib.sha256(f"{key}\n{seen[key]}".encode()).hexdigest()[:12]
        lines = place.statement if _is_simple(place.statement) else node
        found.append(
            Mutant(
                mark,
                file,
                lines.lineno,
                lines.end_lineno or lines.lineno,
                place.function,
                operator,
                before,
                " ".join(after.split()),
                place.mentioned,
                (begin, stop),
                after,
            )
        )
    return found


def _span(node: ast.expr | ast.stmt, starts: list[int]) -> tuple[int, int]:
    end_line, end_column = node.end_lineno or node.lineno, node.end_col_offset or 0
    return starts[node.lineno - 1] + node.col_offset, starts[end_line - 1] + end_column


def _text(node: ast.AST) -> str:
    text = ast.unparse(node)
    atoms = (ast.Name, ast.Constant, ast.Attribute, ast.Call, ast.Subscript, ast.Slice, ast.stmt, ast.Tuple, ast.List)
    return text if isinstance(node, atoms) else f"({text})"


def _is_simple(statement: ast.stmt) -> bool:
    return not isinstance(
        statement, ast.If | ast.For | ast.While | ast.With | ast.Try | ast.FunctionDef | ast.ClassDef | ast.Match
    )


Change = tuple[_Place, ast.expr | ast.stmt, str, ast.AST]


def _changes(tree: ast.Module) -> Iterator[Change]:
    yield from _block(tree.body, "", "")


def _block(body: list[ast.stmt], function: str, qualified: str) -> Iterator[Change]:
    for statement in body:
        yield from _statement(statement, function, qualified, alone=len(body) == 1)


def _statement(statement: ast.stmt, function: str, qualified: str, *, alone: bool) -> Iterator[Change]:
    match statement:
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            if any(_last_name(one) in {"overload", "abstractmethod"} for one in statement.decorator_list):
                return
            inner = f"{qualified}.{statement.name}" if qualified else statement.name
            place = _Place(function, inner, statement, (statement.name,))
            for default in (*statement.args.defaults, *(one for one in statement.args.kw_defaults if one)):
                for node, operator, new in _constants(default):
                    yield place, node, "default changed" if operator == "constant changed" else operator, new
            free = any(_last_name(one) == "no_grad" for one in statement.decorator_list)
            for change in _block(statement.body, function or inner, inner):
                # Where there are no gradients, nothing can be detached from them.
                if not (free and change[2] == "call removed" and ast.unparse(change[1]).endswith(".detach()")):
                    yield change
            return
        case ast.ClassDef():
            inner = f"{qualified}.{statement.name}" if qualified else statement.name
            if not any(_last_name(base) == "Protocol" for base in statement.bases):
                yield from _block(
                    statement.body, function, f"{qualified}.{statement.name}" if qualified else statement.name
                )
            return
        case ast.Import() | ast.ImportFrom() | ast.Raise() | ast.Assert() | ast.Global() | ast.Nonlocal() | ast.Pass():
            if isinstance(statement, ast.Raise) and function and not alone:
                place = _Place(function, qualified, statement, ())
                yield place, statement, "statement deleted", ast.Pass()
            return
        case ast.Expr(value=ast.Constant()):
            return
        case ast.If(test=test) if _last_name(test) == "TYPE_CHECKING":
            return
    targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
    mentioned = tuple(
        name.id for target in targets if target is not None for name in ast.walk(target) if isinstance(name, ast.Name)
    )
    if "__all__" in mentioned:
        return
    if isinstance(statement, ast.Expr) and _is_telling(statement.value):
        return
    place = _Place(function, qualified, statement, mentioned)
    if function:
        yield from ((place, *change) for change in _deleted(statement, alone=alone))
    for field, value in ast.iter_fields(statement):
        if field in {"annotation", "type_params", "target", "targets", "type_comment"} and not isinstance(
            statement, ast.AugAssign
        ):
            continue
        if isinstance(value, ast.expr):
            if field == "test":
                yield place, value, "condition negated", _negated(value)
            yield from ((place, *change) for change in _expression(value))
        elif isinstance(value, list):
            for one in value:
                if isinstance(one, ast.stmt):
                    yield from _statement(one, function, qualified, alone=len(value) == 1)
                elif isinstance(one, ast.expr) and field != "targets":
                    yield from ((place, *change) for change in _expression(one))
                elif isinstance(one, ast.withitem):
                    yield from ((place, *change) for change in _expression(one.context_expr))
                elif isinstance(one, ast.ExceptHandler | ast.match_case):
                    yield from _block(one.body, function, qualified)


Found = tuple[ast.expr | ast.stmt, str, ast.AST]


def _deleted(statement: ast.stmt, *, alone: bool) -> Iterator[Found]:
    match statement:
        case ast.Return(value=None) | ast.Return(value=ast.Constant(value=None)):
            if not alone:
                yield statement, "statement deleted", ast.Pass()
        case ast.Return(value=ast.Tuple(elts=[first, second, *rest])):
            swapped = ast.Tuple([second, first, *rest], ast.Load())
            yield statement, "return value swapped", ast.Return(swapped)
        case ast.Return():
            yield statement, "return value dropped", ast.Return(ast.Constant(None))
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) | ast.AugAssign() | ast.Continue() | ast.Break():
            yield statement, "statement deleted", ast.Pass()
        case ast.Expr() | ast.Delete():
            yield statement, "statement deleted", ast.Pass()
        case ast.Assign(targets=[ast.Name(id=name)], value=value):
            # A first assignment can't go without a crash that any call notices; one of a value known before can.
            if any(isinstance(one, ast.Name) and one.id == name for one in ast.walk(value)):
                yield statement, "statement deleted", ast.Pass()
    if isinstance(statement, ast.AugAssign):
        for new in ARITHMETIC[type(statement.op)]:
            changed = copy.copy(statement)
            changed.op = new()
            yield statement, "arithmetic swapped", changed


def _expression(node: ast.expr) -> Iterator[Found]:
    """Every change of an expression and of what it holds; texts, annotations and calls that only tell are passed by."""
    if isinstance(node, ast.JoinedStr | ast.Constant) and not _is_number(node):
        return
    if isinstance(node, ast.Lambda):
        yield from _expression(node.body)
        return
    if isinstance(node, ast.Call) and (_is_telling(node) or _last_name(node.func) in _NOT_CODE):
        return
    match node:
        case ast.Constant() | ast.UnaryOp(op=ast.USub(), operand=ast.Constant()):
            yield from _constants(node)
            return
        case ast.Compare(ops=ops):
            for index, one in enumerate(ops):
                for new in COMPARISONS[type(one)]:
                    changed = copy.copy(node)
                    changed.ops = [*ops[:index], new(), *ops[index + 1 :]]
                    yield node, "comparison swapped", changed
        case ast.BinOp(op=op) if not _is_textual(node):
            for new in ARITHMETIC[type(op)]:
                yield node, "arithmetic swapped", ast.BinOp(node.left, new(), node.right)
        case ast.BoolOp(op=op, values=values):
            yield node, "boolean swapped", ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield node, "unary operator removed", operand
        case ast.IfExp(test=test, body=body, orelse=orelse):
            yield node, "condition negated", ast.IfExp(test, orelse, body)
        case ast.Call():
            yield from _call(node)
        case ast.Subscript(slice=ast.Slice()):
            yield from _slice(node, node.slice, lambda new: new)
        case ast.Subscript(slice=ast.Tuple(elts=elements)):
            for index, one in enumerate(elements):
                if isinstance(one, ast.Slice):
                    yield from _slice(node, one, lambda new, index=index: _put(elements, index, new))
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            yield from _expression(child)
        elif isinstance(child, ast.keyword):
            if child.arg not in _IDLE_ARGUMENTS:
                yield from _expression(child.value)
        elif isinstance(child, ast.comprehension):
            yield from _expression(child.iter)
            for condition in child.ifs:
                yield condition, "condition negated", _negated(condition)
                yield from _expression(condition)
        elif isinstance(child, ast.Slice):
            for part in (child.lower, child.upper, child.step):
                if part is not None and not _is_number(part):
                    yield from _expression(part)


def _constants(node: ast.expr) -> Iterator[Found]:
    """A number's changes: twice as large, one more, nothing, the sign; a truth value's opposite."""
    operator = "constant changed"
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield node, operator, ast.Constant(not node.value)
        return
    if not _is_number(node):
        if isinstance(node, ast.BinOp | ast.Tuple | ast.List):
            yield from _expression(node)
        return
    value = ast.literal_eval(node)
    if isinstance(value, complex):
        return
    changed = {repr(new) for new in (2 * value, value + 1, 0 * value, -value)} - {repr(value), "-0", "-0.0"}
    for new in sorted(changed):
        yield node, operator, ast.parse(new, mode="eval").body


def _call(node: ast.Call) -> Iterator[Found]:
    name = _last_name(node.func)
    if name in PARTNERS:
        changed = copy.copy(node)
        if isinstance(node.func, ast.Attribute):
            changed.func = ast.Attribute(node.func.value, PARTNERS[name], ast.Load())
        else:
            changed.func = ast.Name(PARTNERS[name], ast.Load())
        if not (isinstance(node.func, ast.Name) and PARTNERS[name] not in {"min", "max", "any", "all", "sum"}):
            yield node, "function swapped", changed
    if name in REMOVABLE:
        if isinstance(node.func, ast.Attribute) and not _is_module(node.func.value):
            yield node, "call removed", node.func.value
        elif node.args:
            yield node, "call removed", node.args[0]
    if name == "isinstance":
        return
    if len(node.args) >= 2 and name not in _COMMUTES and not any(isinstance(one, ast.Starred) for one in node.args):
        first, second = node.args[:2]
        # A text in the place of something else is a crash, and proves nothing.
        if ast.dump(first) != ast.dump(second) and _is_textual(first) == _is_textual(second):
            changed = copy.copy(node)
            changed.args = [second, first, *node.args[2:]]
            yield node, "arguments swapped", changed
    for index, keyword in enumerate(node.keywords):
        if keyword.arg is not None and keyword.arg not in _IDLE_ARGUMENTS:
            changed = copy.copy(node)
            changed.keywords = [*node.keywords[:index], *node.keywords[index + 1 :]]
            yield node, "argument dropped", changed


def _slice(node: ast.Subscript, part: ast.Slice, put: Callable[[ast.Slice], ast.expr]) -> Iterator[Found]:
    """A slice's ends, each moved by one; an open end is moved too."""
    moved = []
    if part.lower is None and part.upper is None:
        return
    lower = ast.Constant(1) if part.lower is None else ast.BinOp(part.lower, ast.Add(), ast.Constant(1))
    moved.append(ast.Slice(lower, part.upper, part.step))
    upper = ast.Constant(-1) if part.upper is None else ast.BinOp(part.upper, ast.Sub(), ast.Constant(1))
    moved.append(ast.Slice(part.lower, upper, part.step))
    for new in moved:
        yield node, "slice shifted", ast.Subscript(node.value, put(new), node.ctx)


def _put(elements: list[ast.expr], index: int, new: ast.expr) -> ast.Tuple:
    return ast.Tuple([*elements[:index], new, *elements[index + 1 :]], ast.Load())


def _negated(test: ast.expr) -> ast.expr:
    return (
        test.operand if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not) else ast.UnaryOp(ast.Not(), test)
    )


def _is_number(node: ast.AST) -> bool:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return _is_number(node.operand)
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def _is_textual(node: ast.expr) -> bool:
    """Whether this is a text, or texts that are put together or formatted, or types (`int | None`)."""
    if isinstance(node, ast.BinOp):
        return _is_textual(node.left) or _is_textual(node.right)
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and not _is_number(node))


def _is_telling(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and _last_name(node.func) in TELLING


def _is_module(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id in {"torch", "np", "math", "functional", "cv2", "ndimage"}


def _last_name(node: ast.AST) -> str:
    if isinstance(node, ast.Call | ast.Subscript):
        return _last_name(node.func if isinstance(node, ast.Call) else node.value)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
