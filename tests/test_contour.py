"""Primary contours (6.2.2): exact where the source gives a formula, and where they cross into inversion."""

import csv
from itertools import permutations, product

import numpy as np
import pytest

from extremal.forms.contour import attraction, crosses_into_inversion, evaluate, is_valid, plane
from extremal.forms.kernel import Kernel
from extremal.forms.laws import law
from extremal.forms.material import Material

GRID = np.linspace(-1.5, 4.0, 80) + 1.3e-3


def law_at(name, dimension, extension="none", poisson_ratio=0.45, **more):
    """Kernel and parameters for E = 1."""
    made = law(name, dimension)
    moduli = {"young_modulus": 1.0, "poisson_ratio": poisson_ratio}
    material = Material(made, moduli, extension=extension, **more)
    return Kernel(made, extension), material.values(np.zeros((1, 3)))[0]


def primary_points(name, dimension, fixed=None, **how):
    """Valid points of the piece through rest, and the law."""
    kernel, parameters = law_at(name, dimension, **how)
    found = plane(kernel, parameters, GRID, GRID + 1e-3, fixed)
    points = found.segments[found.primary].reshape(-1, 2)
    if fixed is not None:
        points = np.column_stack([np.full(len(points), fixed), points])
    return points[is_valid(points)], kernel, parameters


@pytest.mark.parametrize("poisson_ratio", [0.1, 0.3, 0.49])
@pytest.mark.parametrize("dimension, fixed", [(2, None), (3, 0.7), (3, 2.0)])
def test_corotated_contour_is_the_plane_of_constant_trace(dimension, fixed, poisson_ratio):
    """Σ(σi - 1) = 0 whatever the moduli, with v = (1, .., 1)/√d and eigenvalue 2μ + dλ."""
    points, kernel, parameters = primary_points("corotated", dimension, fixed, poisson_ratio=poisson_ratio)
    assert len(points) > 50
    assert np.abs(points.sum(axis=1) - dimension).max() < 1e-12
    v, _ = attraction(kernel, parameters, points)
    assert np.abs(v - 1 / np.sqrt(dimension)).max() < 1e-10


@pytest.mark.parametrize("name, extension", [("fixed_corotated", "none"), ("neo_hookean", "c2"), ("neo_hookean", "c1")])
def test_on_a_contour_the_strongest_component_of_the_gradient_vanishes(name, extension):
    points, kernel, parameters = primary_points(name, 2, extension=extension)
    _, g, H = evaluate(kernel, parameters, points)
    values, vectors = np.linalg.eigh(H)
    strongest = np.abs(values).argmax(axis=1)
    v = vectors[np.arange(len(points)), :, strongest]
    assert len(points) > 50
    assert np.abs((v * g).sum(axis=1)).max() < 1e-12 * np.abs(H).max()


def test_the_corrected_contour_tends_to_constant_volume():
    """(6.1): J = 1 is the contour of its λ term alone; with μ it is approached as ν tends to 1/2."""
    distances = []
    for poisson_ratio in (0.4, 0.45, 0.49, 0.499):
        points, _, _ = primary_points("fixed_corotated", 2, poisson_ratio=poisson_ratio)
        distances.append(np.abs(points.prod(axis=1) - 1).max())
    # J - 1 is of the order of μ/λ = (1 - 2ν)/(2ν) and falls with it
    assert np.all(np.diff(distances) < 0)
    assert distances[-1] < 0.01 < distances[0]


@pytest.mark.parametrize("poisson_ratio", [0.2, 0.45])
def test_corotated_crosses_at_a_known_place(poisson_ratio):
    flat = crosses_into_inversion(*law_at("corotated", 2, poisson_ratio=poisson_ratio))
    assert np.allclose(flat.inversion, [2, 0], atol=1e-6) and flat.kink is None
    solid = crosses_into_inversion(*law_at("corotated", 3, poisson_ratio=poisson_ratio))
    assert np.allclose(solid.inversion, [1.5, 1.5, 0], atol=1e-5)
    assert np.isclose(solid.kink[0], 3)  # σ2 + σ3 = 0 leaves σ1 = 3: no slice beyond has the contour
    assert solid.sentence() == (
        "the primary contour enters the inverted region (σ3 < 0) at σ = (1.5, 1.5, 0) "
        "and meets the kink σ2 + σ3 = 0 where σ1 = 3"
    )


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.45, 0.49])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name, extension", [("neo_hookean", "c2"), ("fixed_corotated", "none")])
def test_corrected_and_c2_contours_never_cross(name, extension, dimension, poisson_ratio):
    found = crosses_into_inversion(*law_at(name, dimension, extension, poisson_ratio), steps=120)
    assert found.inversion is None and found.kink is None
    assert found.sentence() == "the primary contour never enters the inverted region (stretches up to 10)"


def test_c1_crosses_far_out_only():
    """Not said in the source: at ε = .4 and ν = .45 the C1 contour does enter, beyond a stretch of 7."""
    found = crosses_into_inversion(*law_at("neo_hookean", 2, "c1"))
    assert found.inversion[0] > 7
    v, f = attraction(*law_at("neo_hookean", 2, "c1"), found.inversion[None])
    assert abs(f[0]) < 1e-10


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name, extension", [("corotated", "none"), ("neo_hookean", "c1"), ("neo_hookean", "c2")])
def test_energy_does_not_change_with_two_signs_or_two_places(name, extension, dimension):
    kernel, parameters = law_at(name, dimension, extension)
    σ = np.array([1.4, 0.8, -0.3])[[0, 1, 2] if dimension == 3 else [0, 2]]
    Ψ, g, H = evaluate(kernel, parameters, σ[None])
    for order in permutations(range(dimension)):
        for signs in product((1, -1), repeat=dimension):
            if np.prod(signs) < 0:
                continue
            place, sign = list(order), np.array(signs)
            Ψ1, g1, H1 = evaluate(kernel, parameters, (sign * σ[place])[None])
            assert np.isclose(Ψ1, Ψ, rtol=1e-13)
            assert np.allclose(g1[0], sign * g[0][place], rtol=1e-12, atol=1e-13)
            expected = H[0][np.ix_(place, place)] * np.outer(sign, sign)
            assert np.allclose(H1[0], expected, rtol=1e-12, atol=1e-12)


def test_invalid_stretches_are_those_of_the_sign_convention():
    assert is_valid(np.array([1.0, -0.5])) and not is_valid(np.array([0.5, -1.0]))
    assert is_valid(np.array([1.0, -0.5, 0.6])) and not is_valid(np.array([3.0, -0.5, 0.4]))


def test_the_corotated_energy_has_a_kink_and_the_gradient_jumps_there():
    """6.2.1: along σ2 + σ3 = 2t the slope changes its sign at t = 0."""
    kernel, parameters = law_at("corotated", 3)
    slopes = []
    for t in (1e-9, -1e-9):
        _, g, _ = evaluate(kernel, parameters, np.array([[1.0, 0.2 + t, -0.2 + t]]))
        slopes.append(g[0, 1] + g[0, 2])
    assert np.isclose(slopes[0], -slopes[1], rtol=1e-6) and abs(slopes[0]) > 1


# ---------------------------------------------------------------- the study


def test_study_writes_what_it_draws(launch, tmp_path):
    done = launch(0, "-m", "extremal.app", "study", "contour", "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == (
        "corotated, ν = 0.45, 2D: the primary contour enters the inverted region (σ2 < 0) at σ = (2, 0)"
    )
    assert lines[2].startswith("Neo-Hookean, C2 extension, ν = 0.45, 2D: the primary contour never enters")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "contour.csv",
        "contour.png",
        "surface.npz",
        "surface.png",
    ]
    with open(tmp_path / "contour.csv", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["law"] == "corotated" and row["primary"] == "1"]
    assert len(rows) > 100
    assert all(abs(float(row["sigma1"]) + float(row["sigma2"]) - 2) < 1e-12 for row in rows)
    with np.load(tmp_path / "surface.npz") as arrays:
        energy = arrays["neo_hookean_c2_energy"]
    assert energy.shape == (201, 201) and np.isfinite(energy).all() and energy.min() > -1e-12


def test_study_of_a_custom_energy_and_on_two_ranks(launch, tmp_path):
    words = ["--energy", "mu*(i1 - d)**2 + lam*(J - 1)**2", "--poisson-ratio", "0.4"]
    done = launch(2, "-m", "extremal.app", "study", "contour", *words, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("custom, ν = 0.4, 2D: the primary contour") == 1
    assert (tmp_path / "contour.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    "words, message",
    [
        (["--law", "corotate"], "--law corotate: unknown; did you mean corotated?"),
        (["--law", "corotated", "--dimension", "4"], "--dimension 4: must be 2 or 3"),
        (["--poisson-ratio", "0.5"], "--poisson-ratio 0.5: must be above -1 and below 0.5"),
        (
            ["--extension", "c2"],
            "--extension c2: belongs to --law or --energy; give one of them as well",
        ),
        (["--energy", "s1 + 2*s2"], "--energy: energy changes when stretches are exchanged: "
         "it must be symmetric in s1, s2, s3 (isotropic)"),
        (["--energy", "mu*(i1 - q)"], "--energy: column 10: unknown name 'q'; "
         "known: i1, i2, J, I1, I2, s1, s2, s3, d, mu, lam, pi, e"),
    ],
)  # fmt: skip
def test_study_refuses_in_one_line(launch, tmp_path, words, message):
    done = launch(0, "-m", "extremal.app", "study", "contour", *words, "-o", tmp_path / "out")
    assert (done.returncode, done.stderr.strip()) == (2, f"extremal: {message}")
    assert not (tmp_path / "out").exists()
