"""Custom energies and material parameters: what is refused and in which words; compiled code is kept."""

import subprocess

import numpy as np
import pytest
import sympy as sp

from extremal import native
from extremal.forms.kernel import Kernel
from extremal.forms.laws import LawError, custom, law
from extremal.forms.material import Material, density_at, lame_parameters, young_poisson

J, I1, I2, i1, i2, s1, s2, s3, mu, a = sp.symbols("J I1 I2 i1 i2 s1 s2 s3 mu a")
X = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])

BAD = {
    "unknown symbol": (
        mu * I1 + sp.Symbol("q"),
        3,
        (),
        "energy uses 'q': it may use I1, I2, J, d, i1, i2, lam, lambda, lambda_, mu, s1, s2, s3",
    ),
    "parameter with a taken name": (
        mu * I1,
        3,
        ("J",),
        "parameter 'J' has the name of an invariant: choose another name",
    ),
    "not symmetric": (
        mu * (s1**2 + 2 * s2**2 + s3**2),
        3,
        (),
        "energy changes when stretches are exchanged: it must be symmetric in s1, s2, s3 (isotropic)",
    ),
    "not symmetric in the third": (
        mu * (s1**2 + s2**2),
        3,
        (),
        "energy changes when stretches are exchanged: it must be symmetric in s1, s2, s3 (isotropic)",
    ),
    "not smooth": (
        mu * sp.Max(I1, 3),
        3,
        (),
        "energy has Max: it must be smooth, four derivatives are taken",
    ),
    "absolute value": (
        mu * sp.Abs(J - 1) ** sp.Rational(5, 2),
        3,
        (),
        "energy has Abs: it must be smooth, four derivatives are taken",
    ),
    "third stretch in the plane": (
        mu * (s1 + s2 + s3),
        2,
        (),
        "energy uses 's3', which a two-dimensional body does not have: use i1, J, I1, s1, s2",
    ),
    "second invariant in the plane": (
        mu * (I1 + I2),
        2,
        (),
        "energy uses 'I2', which a two-dimensional body does not have: use i1, J, I1, s1, s2",
    ),
    "infinite at rest": (
        mu * sp.log(J - 1),
        3,
        (),
        "energy or its derivatives are not finite at rest, where every stretch and J are 1",
    ),
    "stiffness infinite at rest": (
        mu * (I1 - 3) ** sp.Rational(3, 2),
        3,
        (),
        "energy or its derivatives are not finite at rest, where every stretch and J are 1",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_an_energy_that_cannot_be_used_is_refused_with_the_reason(case):
    energy, dimension, parameters, message = BAD[case]
    with pytest.raises(LawError) as caught:
        custom(energy, dimension, parameters)
    assert str(caught.value) == message


def test_unknown_names_are_answered_with_the_known_ones():
    with pytest.raises(LawError) as caught:
        law("neohookean", 3)
    assert str(caught.value) == (
        "law 'neohookean' is unknown: one of neo_hookean, corotated, fixed_corotated, st_venant_kirchhoff, "
        "mooney_rivlin, custom"
    )
    with pytest.raises(LawError) as caught:
        Kernel(law("corotated", 2), "c3")
    assert str(caught.value) == "extension 'c3' is unknown: one of none, c1, c2, ife"


def test_a_custom_energy_equal_to_a_built_in_one_gives_the_same_stress():
    energy = mu / 2 * (I1 - sp.Symbol("d")) - mu * sp.log(J) + sp.Symbol("lam") / 2 * sp.log(J) ** 2
    G = np.random.default_rng(1).normal(size=(50, 4))
    found = []
    for made in (custom(energy, 2), law("neo_hookean", 2)):
        P = np.empty((50, 4))
        Kernel(made, "c2").evaluate(G, np.array([[0.4, 1.7, 0.9, 0.0]]), stress=P)
        found.append(P)
    assert np.array_equal(*found)


def test_parameters_of_a_custom_energy_follow_the_moduli():
    made = custom(a * (I1 - 2 - 2 * sp.log(J)), 2, ("a",))
    material = Material(made, {}, parameters={"a": lambda x: 1 + x[:, 0]})
    μ, λ = lame_parameters(1.0, 0.0)
    assert np.allclose(material.values(X), [[μ, λ, 1, 0.9, 0], [μ, λ, 2, 0.9, 0]])


# ---------------------------------------------------------------- materials


def neo_hookean(young_modulus=1.0, poisson_ratio=0.3, **more):
    return Material(law("neo_hookean", 3), {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio}, **more)


@pytest.mark.parametrize(
    "material, message",
    [
        (neo_hookean(young_modulus=-2.0), "young_modulus = -2 at (0, 0, 0): must be above 0"),
        (neo_hookean(poisson_ratio=0.5), "poisson_ratio = 0.5 at (0, 0, 0): must be above -1 and below 0.5"),
        (
            neo_hookean(poisson_ratio=lambda x: 0.4 + 0.1 * x[:, 0]),
            "poisson_ratio = 0.5 at (1, 2, 3): must be above -1 and below 0.5",
        ),
        (neo_hookean(young_modulus=np.nan), "young_modulus = nan at (0, 0, 0): must be above 0"),
    ],
)
def test_moduli_out_of_range_are_refused_with_the_place(material, message):
    with pytest.raises(LawError) as caught:
        material.values(X)
    assert str(caught.value) == message


def test_density_must_be_positive():
    with pytest.raises(LawError) as caught:
        density_at(neo_hookean(density=lambda x: 1 - x[:, 2]), X)
    assert str(caught.value) == "density = -2 at (1, 2, 3): must be above 0"


def test_moduli_convert_both_ways():
    young, poisson = young_poisson(*lame_parameters(np.array([7.0]), np.array([0.45])))
    assert np.allclose([young[0], poisson[0]], [7.0, 0.45], rtol=1e-14)


def test_a_continuation_caps_poissons_ratio_and_replaces_the_threshold():
    material = neo_hookean(poisson_ratio=lambda x: 0.2 + 0.29 * x[:, 0])
    values = material.values(X, poisson_ratio=0.3, threshold=0.5)
    for row, ν in zip(values, (0.2, 0.3)):
        assert np.allclose(row[:2], lame_parameters(1.0, ν))
        assert row[2] == 0.5
    assert np.allclose(material.values(X)[:, 2], 0.9)


def test_default_stiffness_of_c1_is_the_safe_one():
    """k = max(20 E, λ/ε²); the user is told when a value of his own is below λ/ε²."""
    assert neo_hookean(extension="c1").values(X)[0, 3] == 20
    nearly = neo_hookean(poisson_ratio=0.499, extension="c1")
    λ = lame_parameters(1.0, 0.499)[1]
    assert np.isclose(nearly.values(X)[0, 3], λ / 0.4**2)
    assert nearly.warnings(X) == []
    assert neo_hookean(extension="c1", stiffness=20.0).warnings(X) == []
    (warning,) = neo_hookean(poisson_ratio=0.499, extension="c1", stiffness=20.0).warnings(X)
    assert warning == (
        f"stiffness = 20 Pa of the C1 extension is below λ/ε² = {λ / 0.4**2:g} Pa: "
        "inverted states can have less energy than rest"
    )


# ---------------------------------------------------------------- compiled code


def test_a_law_is_compiled_once(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    calls = []
    run = subprocess.run

    def counted(*arguments, **options):
        calls.append(arguments)
        return run(*arguments, **options)

    monkeypatch.setattr(native.subprocess, "run", counted)
    Kernel(law("corotated", 2), "none")
    Kernel(law("corotated", 2), "none")
    assert len(calls) == 1
    Kernel(law("corotated", 2), "c2")
    assert len(calls) == 2
    assert len(list((tmp_path / "extremal").iterdir())) == 2  # two libraries and no rubbish


def test_a_compiler_that_fails_is_reported_in_one_line(tmp_path, monkeypatch):
    compiler = tmp_path / "cc"
    compiler.write_text(
        "#!/bin/sh\necho warning: strange >&2\necho error: no such machine >&2\necho error: more >&2\nexit 1\n"
    )
    compiler.chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", str(compiler))
    with pytest.raises(LawError) as caught:
        Kernel(law("corotated", 2), "none")
    message = str(caught.value)
    assert message.startswith("law 'corotated' did not compile: ") and message.endswith("error: no such machine")


def test_no_compiler_is_reported_by_name(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", "/nowhere/cc")
    with pytest.raises((LawError, OSError)) as caught:
        Kernel(law("corotated", 2), "none")
    assert "/nowhere/cc" in str(caught.value)
