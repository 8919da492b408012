"""The expression of ``ros2 topic echo --filter``: a test for a message m, read as Python and never run as such."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

from ros2_fallback.command import CommandError

__all__ = ["FUNCTIONS", "message_test"]

#: What an expression may call.
FUNCTIONS: dict[str, Callable[..., Any]] = {
    function.__name__: function for function in (abs, all, any, len, max, min, round, sum)
}

_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod, ast.Pow: operator.pow, ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_, ast.BitXor: operator.xor, ast.Not: operator.not_, ast.USub: operator.neg,
    ast.UAdd: operator.pos, ast.Invert: operator.invert, ast.Eq: operator.eq, ast.NotEq: operator.ne,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_,
    ast.IsNot: operator.is_not, ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b,
}  # fmt: skip

_NODES = (
    ast.Constant, ast.Subscript, ast.Slice, ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.List,
    ast.Tuple, ast.expr_context, ast.boolop, *_OPERATORS,
)  # fmt: skip


def message_test(expression: str | None) -> Callable[[Any], bool]:
    """A test for messages from an expression in ``m``; None: every message passes.

    Raises:
        CommandError: if it is no such expression; the test raises it if the expression fails.
    """
    if expression is None:
        return lambda _message: True
    try:
        tree = ast.parse(expression.strip(), "--filter", "eval").body
        _check(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise CommandError(f"--filter '{expression}': {error}") from None

    def accept(message: Any) -> bool:
        try:
            return bool(_value(tree, {"m": message}))
        except Exception as error:
            raise CommandError(f"--filter '{expression}': {error}") from error

    return accept


def _check(tree: ast.expr) -> None:
    """Refuse what :func:`_value` cannot evaluate, before any message has come.

    Raises:
        ValueError: it names what is not allowed.
    """
    names = {name.id for name in ast.walk(tree) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)}
    for node in ast.walk(tree):
        allowed = isinstance(node, _NODES)
        if isinstance(node, ast.Name):
            allowed = node.id in ("m", *FUNCTIONS, *names)
        elif isinstance(node, ast.Attribute):
            allowed = not node.attr.startswith("_")
        elif isinstance(node, ast.Call):
            allowed = isinstance(node.func, ast.Name) and node.func.id in FUNCTIONS and not node.keywords
        elif isinstance(node, (ast.GeneratorExp, ast.ListComp)):
            target = node.generators[0].target
            # A function keeps its name: what is called is never a message's.
            allowed = len(node.generators) == 1 and isinstance(target, ast.Name) and target.id not in ("m", *FUNCTIONS)
        elif isinstance(node, ast.comprehension):
            allowed = not node.is_async
        if not allowed:
            raise ValueError(f"{ast.unparse(node)!r} is not allowed; see --help")


def _value(node: Any, names: Mapping[str, Any]) -> Any:
    """The value of a checked expression."""
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.Name):
        return names[node.id] if node.id in names else FUNCTIONS[node.id]
    if isinstance(node, ast.Attribute):
        return getattr(_value(node.value, names), node.attr)
    if isinstance(node, ast.Subscript):
        return _value(node.value, names)[_value(node.slice, names)]
    if isinstance(node, ast.Slice):
        return slice(*(None if part is None else _value(part, names) for part in (node.lower, node.upper, node.step)))
    if isinstance(node, ast.UnaryOp):
        return _OPERATORS[type(node.op)](_value(node.operand, names))
    if isinstance(node, ast.BinOp):
        return _OPERATORS[type(node.op)](_value(node.left, names), _value(node.right, names))
    if isinstance(node, ast.BoolOp):
        return _either(node, names)
    if isinstance(node, ast.Compare):
        return _compared(node, names)
    if isinstance(node, ast.IfExp):
        return _value(node.body if _value(node.test, names) else node.orelse, names)
    if isinstance(node, ast.Call):
        return _value(node.func, names)(*(_value(argument, names) for argument in node.args))
    if isinstance(node, (ast.List, ast.Tuple)):
        elements = [_value(element, names) for element in node.elts]
        return elements if isinstance(node, ast.List) else tuple(elements)
    each = node.generators[0]
    turns = ({**names, each.target.id: item} for item in _value(each.iter, names))
    return [_value(node.elt, turn) for turn in turns if all(_value(test, turn) for test in each.ifs)]


def _either(node: ast.BoolOp, names: Mapping[str, Any]) -> Any:
    value = None
    for part in node.values:
        value = _value(part, names)
        if bool(value) == isinstance(node.op, ast.Or):
            break
    return value


def _compared(node: ast.Compare, names: Mapping[str, Any]) -> Any:
    left, value = _value(node.left, names), True
    for how, part in zip(node.ops, node.comparators, strict=True):
        right = _value(part, names)
        value = _OPERATORS[type(how)](left, right)
        if not value:
            break
        left = right
    return value
