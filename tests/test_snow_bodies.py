"""Bodies of snow: what is inside, how it is seeded, and what varies within it."""

import time

import numpy as np
import pytest

from extremal.mpm import bodies
from extremal.mpm.bodies import Box, Cylinder, HeightField, Sphere, SurfaceMesh, Text, Wedge, noise, seed, shell_profile
from extremal.obstacles.hollow import Bowl, Tube
from extremal.obstacles.shapes import HalfSpace

REGIONS = {
    "box": (Box((-0.3, -0.5, -0.2), (0.4, 0.1, 0.9)), 0.7 * 0.6 * 1.1),
    "rectangle": (Box((-0.3, -0.5), (0.4, 0.1)), 0.7 * 0.6),
    "sphere": (Sphere((0.1, 0, -0.2), 0.5), 4 / 3 * np.pi * 0.5**3),
    "disc": (Sphere((0.1, 0), 0.5), np.pi * 0.5**2),
    "cylinder": (Cylinder((0.1, 0.2, 0.3), 0.4, 0.9, (1, 2, -1)), np.pi * 0.4**2 * 0.9),
    "tube": (Tube((0.1, 0, 0.2), 0.4, 0.2, 0.6, (0, 1, 0)), np.pi * 0.2 * 0.6 + 2 * np.pi**2 * 0.01 * 0.5),
    "bowl": (Bowl((0.1, 0, 0.2), 0.4, 0.2), 2 / 3 * np.pi * (0.6**3 - 0.4**3) + np.pi**2 * 0.01 * 0.5),
    "wedge": (Wedge((0, 0, 0.3), 0.5, 0.4, 0.8, up=(1, 0, 2)), 0.5 * 0.4 / 2 * 0.8),
    "triangle": (Wedge((0, 0.3), 0.5, 0.4), 0.5 * 0.4 / 2),
    "slope": (HeightField(lambda q: 0.3 + 0.2 * q[:, 0] - 0.1 * q[:, 1], (-0.5, -0.5), (0.5, 0.5)), 0.3),
    "hill": (HeightField([0.1, 0.4, 0.1], (-0.5,), (0.5,)), 0.25),
    "letter": (Text("I", 0.7, 0.2, (0, 0, 0)), None),
}


@pytest.mark.parametrize("name", REGIONS)
def test_a_seeded_body_has_the_volume_of_its_region(name):
    region, volume = REGIONS[name]
    low, high = region.bounds()
    h = 0.05 if len(low) == 3 else 0.01
    x = seed(region, h, 8, seed=3)
    assert region.inside(x).all() and (x >= low).all() and (x <= high).all()
    if volume is None:  # a sans serif I is a bar as wide as its box
        volume = np.prod(high - low)
    # boundary cells are filled at random: some hundred of them, each off by less than its own volume
    assert len(x) * h ** len(low) / 8 == pytest.approx(volume, rel=0.02)
    # the box is tight: points come near each of its sides
    assert np.allclose(x.min(axis=0), low, atol=1.5 * h) and np.allclose(x.max(axis=0), high, atol=1.5 * h)


@pytest.mark.parametrize("per_cell", [1, 4, 5, 6, 8, 10])
@pytest.mark.parametrize("dim", [2, 3])
def test_every_whole_cell_gets_exactly_per_cell_points_each_in_a_part_of_its_own(dim, per_cell):
    h = 0.125
    x = seed(Box([-0.5] * dim, [0.5] * dim), h, per_cell, seed=1)
    cell = np.floor(x / h).astype(int)
    _, counts = np.unique(cell, axis=0, return_counts=True)
    assert len(counts) == 8**dim and (counts == per_cell).all()
    k = int(np.ceil(per_cell ** (1 / dim) - 1e-9))
    assert len(np.unique(np.floor(x * k / h).astype(int), axis=0)) == len(x)


@pytest.mark.parametrize("per_cell", [5, 8])
def test_points_are_spread_evenly_over_the_cell_and_over_neighbours(per_cell):
    x = seed(Box((0, 0, 0), (1, 1, 1)), 1 / 32, per_cell, seed=5)
    place = x * 32 % 1
    n = len(x)
    # a uniform law has mean 1/2 and variance 1/12; five standard errors
    assert np.abs(place.mean(axis=0) - 0.5).max() < 5 / np.sqrt(12 * n)
    assert np.abs(place.var(axis=0) - 1 / 12).max() < 5 / np.sqrt(180 * n)
    assert np.abs(np.corrcoef(place.T) - np.eye(3)).max() < 5 / np.sqrt(n)
    # the place in one cell says nothing about that in the next one
    first = place[::per_cell]
    assert np.abs(np.corrcoef(first[:-1].T, first[1:].T)[:3, 3:]).max() < 5 / np.sqrt(len(first))


def test_another_seed_gives_other_points_and_the_same_one_the_same():
    ball = Sphere((0, 0, 0), 0.3)
    assert np.array_equal(seed(ball, 0.05, 8, 7), seed(ball, 0.05, 8, 7))
    assert not np.isin(seed(ball, 0.05, 8, 7), seed(ball, 0.05, 8, 8)).any()


@pytest.mark.parametrize("shares", [2, 3, 7, 5000])
def test_shares_one_after_the_other_are_the_whole(shares):
    ball = Sphere((0.1, -0.3), 0.31)
    parts = [seed(ball, 0.02, 5, 2, (k, shares)) for k in range(shares)]
    assert np.array_equal(np.concatenate(parts), seed(ball, 0.02, 5, 2))


def test_what_is_done_at_once_does_not_matter(monkeypatch):
    whole = seed(REGIONS["wedge"][0], 0.03, 6, 2)
    monkeypatch.setattr(bodies, "AT_ONCE", 17)
    assert np.array_equal(whole, seed(REGIONS["wedge"][0], 0.03, 6, 2))


def test_a_body_keeps_its_points_where_a_larger_one_would_have_them():
    small, large = seed(Box((0, 0), (0.4, 0.3)), 0.05, 4, 9), seed(Box((-1, -1), (1, 1)), 0.05, 4, 9)
    held = large[Box((0, 0), (0.4, 0.3)).inside(large)]
    assert np.array_equal(small, held)


@pytest.mark.mpi
def test_ranks_together_seed_what_one_rank_seeds(comm):
    ball = Sphere((0, 0, 0), 0.3)
    mine = seed(ball, 0.04, 8, 4, (comm.rank, comm.size))
    assert np.array_equal(np.concatenate(comm.allgather(mine)), seed(ball, 0.04, 8, 4))


def test_three_hundred_thousand_particles_take_less_than_a_second():
    seconds = []
    for _ in range(3):
        begin = time.process_time()
        n = len(seed(Sphere((0, 0, 0), 1), 0.0482, 8))
        seconds.append(time.process_time() - begin)
    assert n > 295_000 and min(seconds) < 1.0


@pytest.mark.parametrize(
    "wrong, message",
    [
        (lambda: seed(HalfSpace((0, 0), (0, 1)), 0.1, 4), "unbounded region"),
        (lambda: seed(Sphere((0, 0), 1), 0.0, 4), "cell_size must be a finite number above 0, got 0.0"),
        (lambda: seed(Sphere((0, 0), 1), 0.1, 0), "per_cell must be a whole number, 1 or above, got 0"),
        (lambda: Sphere((0, 0), -1), "sphere: radius must be a finite number above 0, got -1"),
        (lambda: Sphere((0,), 1), r"sphere: center must be 2 or 3 finite numbers, got \(0,\)"),
        (lambda: Box((0, 0), (1, 0)), r"box: high must be above low in every component, got \[0, 0\], \[1, 0\]"),
        (lambda: Box((0, 0), (1, 1, 1)), "box: high must be 2 finite numbers"),
        (lambda: Wedge((0, 0, 0), 1, 1), "wedge: length is missing"),
        (lambda: Wedge((0, 0, 0), 1, 1, 1, up=(0, 3, 0)), "wedge: edge must not be zero"),
        (lambda: Text("snow", 1.0), "text: thickness is missing"),
        (lambda: Text("  ", 1.0, 1.0), "text: nothing to draw"),
        (lambda: Text("snow", 1.0, 1.0, font="no-such-font.ttf"), 'font "no-such-font.ttf" is not found'),
        (lambda: HeightField([[1, np.nan], [1, 1]], (0, 0), (1, 1)), "height must be finite"),
        (lambda: HeightField([1, 2], (0, 0), (1, 1)), "height must have 2 axes"),
        (lambda: HeightField([1, 2], (0,), (1,), base=3), "base must be below the greatest height, 2 m, got 3"),
        (lambda: noise(np.zeros((1, 2)), 0.1, -1), "noise: amplitude must be"),
        (lambda: shell_profile(Sphere((0, 0), 1), np.zeros((1, 2)), 0.1, 0), "shell: factor must be"),
        (lambda: SurfaceMesh("nowhere.stl"), "nowhere.stl: no such file"),
    ],
)
def test_a_wrong_value_is_named_with_what_would_be_accepted(wrong, message):
    with pytest.raises(bodies.BodyError, match=message) as caught:
        wrong()
    assert "\n" not in str(caught.value)


def test_letters_have_their_holes_and_read_from_left_to_right():
    word = Text("OI", 1.0, 0.2, (0, 0, 0))
    width = word.size[0]
    middle_of_o, stroke_of_i = np.array([[-width / 2 + 0.45, 0, 0]]), np.array([[width / 2 - 0.05, 0, 0]])
    assert not word.inside(middle_of_o)[0] and word.inside(stroke_of_i)[0]
    # the bowl of a P is above
    x = seed(Text("P", 1.0, center=(0, 0)), 0.02, 4)
    assert x[:, 1].mean() > 0.05


def test_lines_of_text_stand_one_below_the_other():
    x = seed(Text("I\nI", 1.0, center=(0, 0)), 0.01, 4)
    rows = np.flatnonzero(np.histogram(x[:, 1], bins=50, range=(-0.5, 0.5))[0])
    assert rows[0] == 0 and rows[-1] == 49 and (np.diff(rows) > 1).sum() == 1


def test_text_can_be_laid_on_the_ground_and_turned():
    lying = Text("L", 1.0, 0.1, (0, 0, 0), right=(0, 1, 0), up=(-1, 0, 0))
    low, high = lying.bounds()
    assert np.allclose(high - low, [1.0, lying.size[0], 0.1])
    x = seed(lying, 0.02, 8)
    assert x[:, 0].mean() > 0.05  # most of an L is at its foot


def test_a_height_field_is_linear_between_its_samples():
    ridge = HeightField([[0.1, 0.1], [0.5, 0.5], [0.1, 0.1]], (0, 0), (2, 1))
    x = np.array([[0.5, 0.5, z] for z in (0.01, 0.299, 0.301)] + [[0.5, 0.5, -0.01], [-0.01, 0.5, 0.05]])
    assert ridge.inside(x).tolist() == [True, True, False, False, False]


def test_shell_is_its_factor_on_the_surface_and_one_below_it():
    ball = Sphere((0, 0, 0), 1)
    x = np.array([[1, 0, 0], [0, 0.9, 0], [0, 0, 0.8], [0, 0, 0.0]])
    assert np.allclose(shell_profile(ball, x, 0.2, 3.0), [3, 2, 1, 1], atol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_noise_is_smooth_bounded_and_has_no_bias(dim):
    x = seed(Box([-2] * dim, [2] * dim), 0.1 if dim == 3 else 0.02, 4)
    pattern = np.log2(noise(x, 0.25, 1.0, seed=3))
    assert np.abs(pattern).max() <= 1 and 0.15 < pattern.std() < 0.5
    assert abs(pattern.mean()) < 5 * pattern.std() / np.sqrt(16**dim)  # as many independent cells
    assert np.abs(noise(x + 1e-7, 0.25, 1.0, seed=3) / noise(x, 0.25, 1.0, seed=3) - 1).max() < 1e-4
    other = np.log2(noise(x, 0.25, 1.0, seed=4))
    assert abs(np.corrcoef(pattern, other)[0, 1]) < 5 / np.sqrt(16**dim)
    assert np.array_equal(noise(x, 0.25, 1.0, seed=3)[5:9], noise(x[5:9], 0.25, 1.0, seed=3))


def cube_file(path, faces=slice(None)):
    """A cube of edge 2 about the origin."""
    meshio = pytest.importorskip("meshio")
    points = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])[faces]
    meshio.write_points_cells(path, points, [("triangle", triangles.astype(np.int32))])
    return path


@pytest.mark.parametrize("kind", ["stl", "obj", "ply"])
def test_a_surface_mesh_is_what_it_encloses_whichever_way_its_triangles_turn(tmp_path, kind):
    pytest.importorskip("igl", reason="the extra `surfaces` is not installed")
    turned = (slice(None), slice(None, None, -1))
    for faces in (slice(None), turned):
        cube = SurfaceMesh(cube_file(tmp_path / f"cube.{kind}", faces), 0.5, (1, 0, 0))
        x = np.random.default_rng(0).uniform(-1, 1, (4000, 3)) + [1, 0, 0]
        exact = Box((0.5, -0.5, -0.5), (1.5, 0.5, 0.5))
        assert np.array_equal(cube.inside(x), exact.inside(x))
        # sampled on 64 cells, and rounded off at the edges by less than one of them
        assert np.abs(cube.distance(x) - exact.distance(x))[exact.distance(x) < 0.02].max() < 1 / 64


def test_an_open_surface_is_refused_with_the_place_of_the_hole(tmp_path):
    with pytest.raises(bodies.BodyError, match=r"not closed.* 3 edges, one between \(-?1, -?1, -?1\)"):
        SurfaceMesh(cube_file(tmp_path / "open.stl", slice(1, None)))


def test_a_file_that_is_no_surface_is_refused_on_one_line(tmp_path):
    (tmp_path / "junk.stl").write_text("hello\n")
    (tmp_path / "junk.xyz").write_text("hello\n")
    for name in ("junk.stl", "junk.xyz"):
        with pytest.raises(bodies.BodyError, match=f"{name}: .*accepted are STL, OBJ and PLY") as caught:
            SurfaceMesh(tmp_path / name)
        assert "\n" not in str(caught.value)
