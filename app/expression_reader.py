"""The reader behind `expression`: from text to Python's syntax tree to sympy; nothing is executed."""

from __future__ import annotations

import ast
import math
import operator
import re
import unicodedata
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from .errors import InputError, nearest, suggestion

LONGEST = 2000  # characters
MOST_PARTS = 500  # numbers, names, operations
LARGEST_POWER = 64  # of something that varies
LARGEST_CONSTANT_POWER = 1000

CONSTANTS = {"pi": math.pi, "e": math.e}

# name -> (fewest arguments, most, the same function of numbers)
FUNCTIONS: dict[str, tuple[int, int, Callable[..., float]]] = {
    "sin": (1, 1, math.sin),
    "cos": (1, 1, math.cos),
    "tan": (1, 1, math.tan),
    "asin": (1, 1, math.asin),
    "acos": (1, 1, math.acos),
    "atan": (1, 1, math.atan),
    "atan2": (2, 2, math.atan2),
    "sinh": (1, 1, math.sinh),
    "cosh": (1, 1, math.cosh),
    "tanh": (1, 1, math.tanh),
    "exp": (1, 1, math.exp),
    "log": (1, 1, math.log),
    "sqrt": (1, 1, math.sqrt),
    "cbrt": (1, 1, lambda a: math.copysign(abs(a) ** (1 / 3), a)),
    "abs": (1, 1, abs),
    "sign": (1, 1, lambda a: float((a > 0) - (a < 0))),
    "floor": (1, 1, math.floor),
    "ceil": (1, 1, math.ceil),
    "min": (2, 16, min),
    "max": (2, 16, max),
    "where": (3, 3, lambda chosen, a, b: a if chosen else b),
}

_OPERATIONS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARISONS = {ast.Lt: "Lt", ast.LtE: "Le", ast.Gt: "Gt", ast.GtE: "Ge", ast.Eq: "Eq", ast.NotEq: "Ne"}
_COMPARE: dict[str, Callable[[Any, Any], bool]] = {
    name: getattr(operator, name.lower()) for name in _COMPARISONS.values()
}


class ExpressionError(InputError, ValueError):
    """An expression cannot be read, or has no value somewhere; says the column, counted from 1."""


@dataclass(frozen=True)
class Part:
    """A part of an expression: its sympy form, and its value where that is known already."""

    expr: Any
    value: float | bool | None
    logical: bool = False


def read(text: str, names: Sequence[str]) -> Part:
    """Read a whole expression; raises ExpressionError."""
    if len(text) > LONGEST:
        raise ExpressionError(f"has {len(text)} characters; an expression has at most {LONGEST}")
    text = text.strip()
    if reserved := re.search(r"\blambda\b", text):
        raise ExpressionError(f"column {reserved.start() + 1}: lambda is a word of the language; write lam")
    _check_brackets(text)
    try:
        with warnings.catch_warnings():
            # Python would print its advice about text such as 1if.
            warnings.simplefilter("ignore")
            tree = ast.parse(text, mode="eval")
    except SyntaxError as error:
        column = error.offset or 0
        if not 0 < column <= len(text):
            raise ExpressionError("ends too early") from None
        raise ExpressionError(f"column {column}: cannot be read as an expression") from None
    except (ValueError, RecursionError, MemoryError):
        raise ExpressionError("cannot be read as an expression") from None
    if sum(1 for _ in ast.walk(tree)) > 2 * MOST_PARTS:
        raise ExpressionError(f"is too long; an expression has at most {MOST_PARTS} parts")
    try:
        return _Reader(text, names).read(tree.body)
    except RecursionError:
        raise ExpressionError("is nested too deeply") from None


def _check_brackets(text: str) -> None:
    opened: list[int] = []
    for column, letter in enumerate(text, start=1):
        if letter == "(":
            opened.append(column)
        elif letter == ")" and not opened:
            raise ExpressionError(f"column {column}: ')' closes nothing")
        elif letter == ")":
            opened.pop()
        elif letter in "'\"[]{};:\\#@\n=!~&|^%" and not (letter in "=!" and _in_comparison(text, column - 1)):
            hint = {
                "^": "; write ** for powers",
                "=": "; write == to compare",
                "&": "; write and",
                "|": "; write or",
            }
            raise ExpressionError(f"column {column}: '{letter}' has no meaning here{hint.get(letter, '')}")
    if opened:
        raise ExpressionError(f"column {opened[-1]}: '(' is never closed")


def _in_comparison(text: str, i: int) -> bool:
    """Tell whether the = or ! at i belongs to ==, !=, <= or >=."""
    pair_before, pair_after = text[max(i - 1, 0) : i + 1], text[i : i + 2]
    return pair_before in ("==", "!=", "<=", ">=") or pair_after in ("==", "!=")


class _Reader:
    """Turns the tree of Python's own parser into sympy, one known kind of node after another."""

    def __init__(self, text: str, names: Sequence[str]) -> None:
        import sympy

        self.sp = sympy
        self.text = text
        # As Python's parser does: μ may be typed as the Greek letter or as the micro sign.
        self.names = [unicodedata.normalize("NFKC", name) for name in names]

    def read(self, node: ast.expr) -> Part:
        """Return the part below `node`; powers and values are checked before sympy computes any."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self._error(node, "only numbers, names, + - * / **, comparisons and functions are known")
        part: Part = method(node)
        if part.value is not None and not part.logical and not math.isfinite(part.value):
            raise self._error(node, "is not a finite number")
        if part.expr.has(self.sp.zoo, self.sp.nan, self.sp.oo, -self.sp.oo, self.sp.I):
            raise self._error(node, "has no finite real value")
        return part

    def _constant(self, node: ast.Constant) -> Part:
        if type(node.value) not in (int, float):
            raise self._error(node, "is not a number")
        try:
            value = float(node.value)  # type: ignore[arg-type]
        except OverflowError:
            raise self._error(node, "is not a finite number") from None
        if not math.isfinite(value):
            raise self._error(node, "is not a finite number")
        if isinstance(node.value, int):
            return Part(self.sp.Integer(node.value), value)
        exact = self.sp.Rational(repr(value))
        return Part(exact if exact.q < 10**20 and abs(exact.p) < 10**20 else self.sp.Float(value), value)

    def _name(self, node: ast.Name) -> Part:
        if node.id in self.names:
            return Part(self.sp.Symbol(node.id, real=True), None)
        if node.id in CONSTANTS:
            return Part({"pi": self.sp.pi, "e": self.sp.E}[node.id], CONSTANTS[node.id])
        if node.id in FUNCTIONS:
            raise self._error(node, f"the function {node.id} needs its argument, as {node.id}(x)")
        known = [*self.names, *CONSTANTS]
        near = nearest(node.id, [*known, *FUNCTIONS])
        hint = f"did you mean {near}?" if near else f"known: {', '.join(known)}"
        raise self._error(node, f"unknown name '{node.id}'; {hint}")

    def _unaryop(self, node: ast.UnaryOp) -> Part:
        part = self.read(node.operand)
        if isinstance(node.op, ast.Not):
            self._want(node.operand, part, logical=True)
            return Part(self.sp.Not(part.expr), None if part.value is None else not part.value, logical=True)
        if not isinstance(node.op, ast.USub | ast.UAdd):
            raise self._error(node, "only + and - may stand before a number")
        self._want(node.operand, part, logical=False)
        if isinstance(node.op, ast.UAdd):
            return part
        return Part(-part.expr, None if part.value is None else -part.value)

    def _binop(self, node: ast.BinOp) -> Part:
        operation = _OPERATIONS.get(type(node.op))
        if operation is None:
            raise self._error(node, "of the operations only + - * / ** are known")
        left, right = self.read(node.left), self.read(node.right)
        self._want(node.left, left, logical=False)
        self._want(node.right, right, logical=False)
        if isinstance(node.op, ast.Pow) and right.value is not None:
            largest = LARGEST_POWER if left.value is None else LARGEST_CONSTANT_POWER
            if abs(right.value) > largest:
                raise self._error(
                    node.right, f"a power is at most {largest} in size, this one is {right.value:g}"
                )
        value = None
        if left.value is not None and right.value is not None:
            value = self._value(node, operation, left.value, right.value)
        elif isinstance(node.op, ast.Div) and right.value == 0:
            raise self._error(node, "divides by zero")
        return Part(operation(left.expr, right.expr), value)

    def _call(self, node: ast.Call) -> Part:
        if not isinstance(node.func, ast.Name) or node.keywords:
            raise self._error(node, "only functions may be called, as sin(x)")
        name = node.func.id
        if name not in FUNCTIONS:
            known = f"unknown function '{name}'; {suggestion(name, FUNCTIONS, most=len(FUNCTIONS))}"
            raise self._error(
                node, known if name not in self.names else f"'{name}' is not a function; write {name}*(..)"
            )
        fewest, most, of_numbers = FUNCTIONS[name]
        if not fewest <= len(node.args) <= most:
            wanted = str(fewest) if fewest == most else f"{fewest} or more"
            raise self._error(node, f"{name} takes {wanted} argument{'s' * (most > 1)}, not {len(node.args)}")
        parts = [self.read(argument) for argument in node.args]
        for i, (argument, part) in enumerate(zip(node.args, parts, strict=True)):
            self._want(argument, part, logical=name == "where" and i == 0)
        value = None
        if all(part.value is not None for part in parts):
            value = self._value(node, of_numbers, *(part.value for part in parts))
        return Part(self._apply(name, [part.expr for part in parts]), value)

    def _compare(self, node: ast.Compare) -> Part:
        operands = [node.left, *node.comparators]
        parts = [self.read(operand) for operand in operands]
        for operand, part in zip(operands, parts, strict=True):
            self._want(operand, part, logical=False)
        links, values = [], []
        for op, left, right in zip(node.ops, parts, parts[1:], strict=False):
            if type(op) not in _COMPARISONS:
                raise self._error(node, "of the comparisons only < <= > >= == != are known")
            name = _COMPARISONS[type(op)]
            known = left.value is not None and right.value is not None
            values.append(_COMPARE[name](left.value, right.value) if known else None)
            links.append(self.sp.true if values[-1] else self.sp.false) if known else links.append(
                getattr(self.sp, name)(left.expr, right.expr)
            )
        value = all(values) if None not in values else None
        return Part(self.sp.And(*links), value, logical=True)

    def _boolop(self, node: ast.BoolOp) -> Part:
        parts = [self.read(operand) for operand in node.values]
        for operand, part in zip(node.values, parts, strict=True):
            self._want(operand, part, logical=True)
        join, of_values = (self.sp.And, all) if isinstance(node.op, ast.And) else (self.sp.Or, any)
        values = [part.value for part in parts]
        return Part(
            join(*(p.expr for p in parts)), of_values(values) if None not in values else None, logical=True
        )

    def _apply(self, name: str, arguments: list[Any]) -> Any:
        sp = self.sp
        if name == "where":
            condition, yes, no = arguments
            return sp.Piecewise((yes, condition), (no, True))
        special = {"abs": sp.Abs, "min": sp.Min, "max": sp.Max, "ceil": sp.ceiling, "cbrt": self._cube_root}
        function = special[name] if name in special else getattr(sp, name)
        return function(*arguments)

    def _cube_root(self, argument: Any) -> Any:
        """The real root, of negative numbers too."""
        return self.sp.sign(argument) * self.sp.Abs(argument) ** self.sp.Rational(1, 3)

    def _value(self, node: ast.expr, operation: Callable[..., Any], *values: Any) -> float:
        try:
            value = operation(*values)
        except ZeroDivisionError:
            raise self._error(node, "divides by zero") from None
        except OverflowError:
            raise self._error(node, "is not a finite number") from None
        except ValueError:
            raise self._error(node, "has no finite real value") from None
        if isinstance(value, complex):
            raise self._error(node, "has no finite real value")
        return float(value)

    def _want(self, node: ast.expr, part: Part, logical: bool) -> None:
        if part.logical != logical:
            wanted = (
                "a comparison, as x < 1, is wanted here"
                if logical
                else "a number is wanted here, not a comparison"
            )
            raise self._error(node, wanted)

    def _error(self, node: ast.expr, message: str) -> ExpressionError:
        # The parser counts bytes; a person counts letters.
        column = len(self.text.encode()[: node.col_offset].decode(errors="ignore")) + 1
        return ExpressionError(f"column {column}: {message}")
