"""Expressions are read without being executed, and mean the same as the formula on paper."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from extremal.app.expression import ExpressionError, function_of, numeric, parse, parse_condition

NAMES = ("x", "y", "z", "t")

BAD = [
    ("", "ends too early"),
    ("x**2 +", "ends too early"),
    ("q + 1", "column 1: unknown name 'q'; known: x, y, z, t, pi, e"),
    ("x + sin", "column 5: the function sin needs its argument, as sin(x)"),
    ("sine(x)", "column 1: unknown function 'sine'; did you mean sin?"),
    ("x(2)", "column 1: 'x' is not a function; write x*(..)"),
    ("sin(x, y)", "column 1: sin takes 1 argument, not 2"),
    ("max(x)", "column 1: max takes 2 or more arguments, not 1"),
    ("sin(x", "column 4: '(' is never closed"),
    ("sin(x))", "column 7: ')' closes nothing"),
    ("2 x", "column 3: cannot be read as an expression"),
    ("x^2", "column 2: '^' has no meaning here; write ** for powers"),
    ("x = 1", "column 3: '=' has no meaning here; write == to compare"),
    ("x[0]", "column 2: '[' has no meaning here"),
    ("x % 2", "column 3: '%' has no meaning here"),
    ("x // 2", "column 1: of the operations only + - * / ** are known"),
    ("x.real", "column 1: only numbers, names, + - * / **, comparisons and functions are known"),
    ("x if y else z", "column 1: only numbers, names, + - * / **, comparisons and functions are known"),
    ("(x, y)", "column 1: only numbers, names, + - * / **, comparisons and functions are known"),
    ("(x + 1)(y)", "column 1: only functions may be called, as sin(x)"),
    ("__import__('os')", "column 12: ''' has no meaning here"),
    ("lambda*x", "column 1: lambda is a word of the language; write lam"),
    ("1j*x", "column 1: is not a number"),
    ("True", "column 1: is not a number"),
    ("x < 1", "is a comparison where a number is wanted; use where(condition, a, b)"),
    ("1 + (x < 1)", "column 6: a number is wanted here, not a comparison"),
    ("where(x, 1, 2)", "column 7: a comparison, as x < 1, is wanted here"),
    ("9**9**9", "column 4: a power is at most 1000 in size, this one is 3.8742e+08"),
    ("(1 + x)**1e9", "column 10: a power is at most 64 in size, this one is 1e+09"),
    ("exp(exp(exp(9)))", "column 5: is not a finite number"),
    ("9**900 * 9**900", "column 1: is not a finite number"),
    ("1e999", "column 1: is not a finite number"),
    ("1/0", "column 1: divides by zero"),
    ("x/(1 - 1)", "column 1: divides by zero"),
    ("sqrt(-1)", "column 1: has no finite real value"),
    ("(-8)**(1/3)", "column 1: has no finite real value"),
    ("log(0)", "column 1: has no finite real value"),
    ("x*" * 1200 + "x", "has 2401 characters; an expression has at most 2000"),
    ("x+" * 600 + "x", "is too long; an expression has at most 500 parts"),
]


@pytest.mark.parametrize(("text", "message"), BAD, ids=[text[:20] for text, _ in BAD])
def test_bad_expression_is_refused_at_its_column(text: str, message: str) -> None:
    start = time.perf_counter()
    with pytest.raises(ExpressionError) as caught:
        parse(text, NAMES)
    assert str(caught.value) == message
    assert time.perf_counter() - start < 2


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2*x**2", lambda x, t: 1 + 2 * x**2),
        ("-x**2", lambda x, t: -(x**2)),
        ("sin(pi*x)*exp(-t)", lambda x, t: np.sin(np.pi * x) * np.exp(-t)),
        ("atan2(x, t) + tanh(x)", lambda x, t: np.arctan2(x, t) + np.tanh(x)),
        ("max(0, x, t) - min(x, 0.5)", lambda x, t: np.maximum(np.maximum(0, x), t) - np.minimum(x, 0.5)),
        ("where(x < 0.5, 1, t)", lambda x, t: np.where(x < 0.5, 1, t)),
        (
            "where(0 < x < 0.5 or not t < 1, x, -1)",
            lambda x, t: np.where((0 < x) & (x < 0.5) | np.greater_equal(t, 1), x, -1),
        ),
        (
            "abs(x) + sign(x) + floor(x) + ceil(x)",
            lambda x, t: np.abs(x) + np.sign(x) + np.floor(x) + np.ceil(x),
        ),
        ("cbrt(x)", lambda x, t: np.cbrt(x)),
        ("log(e) + sqrt(4)", lambda x, t: 3 + 0 * x),
        ("7", lambda x, t: 7 + 0 * x),
    ],
)
def test_expression_means_its_formula(text: str, value) -> None:
    x, t = np.linspace(-2, 2, 41), 0.75
    result = numeric(parse(text, ["x", "t"]), ["x", "t"])(x, t)
    assert result.shape == x.shape and result.dtype == np.float64
    np.testing.assert_allclose(result, value(x, t), rtol=1e-14, atol=1e-15)


def test_condition_gives_booleans() -> None:
    inside = numeric(parse_condition("z < 0.1 and x >= 0", ["x", "z"]), ["x", "z"])
    assert inside([0.0, 0.0, -1.0], [0.0, 1.0, 0.0]).tolist() == [True, False, False]
    assert inside(0, 0).dtype == bool


def test_constants_stay_exact() -> None:
    assert parse("0.1 + 0.2 - 0.3", []) == 0


def test_greek_names_and_the_micro_sign_are_the_same() -> None:
    assert parse("µ*2", ["μ"]) == parse("μ*2", ["µ"])


@given(st.floats(-1e6, 1e6, allow_nan=False))
def test_any_number_is_read_as_itself(number: float) -> None:
    assert float(parse(repr(number), [])) == number


@given(st.text(alphabet="xyzt0123456789.+-*/()<>=,^ eijsn_'\"[]{}:", max_size=30))
def test_any_text_is_either_read_or_refused(text: str) -> None:
    try:
        parse(text, NAMES)
    except ExpressionError as error:
        assert "\n" not in str(error)


def test_undefined_value_is_reported_with_its_place() -> None:
    with pytest.raises(ExpressionError) as caught:
        function_of("log(x)", ["x", "t"])(np.array([0.5, -2.0]), 1)
    assert str(caught.value) == 'expression "log(x)" has no finite real value at x = -2, t = 1'


def test_a_plain_number_is_spread_over_the_points() -> None:
    assert function_of(2, ["x", "t"])(np.zeros((3, 2)), 0).tolist() == [[2, 2]] * 3
