"""A distributed mesh is the given mesh, on any number of ranks."""

import dolfinx
import numpy as np
import pytest
import ufl
from mpi4py import MPI

from extremal.meshes import MeshData, MeshError, compat, distribute, generate
from extremal.meshes.quality import facet_measures

pytestmark = pytest.mark.mpi

BODIES = [
    ("box", {"cell_size": 0.4}),
    ("box", {"cell_size": 0.3, "dimension": 2}),
    ("sphere", {"cell_size": 0.6}),
    ("mattress", {"dimension": 3, "cell_size": 0.2}),
    ("creature", {"cell_size": 0.15, "dimension": 2}),
    ("triangle", {}),
    ("tetrahedron", {}),
]


def made(comm: MPI.Intracomm, shape: str, **parameters) -> MeshData | None:
    return generate(shape, **parameters) if comm.rank == 0 else None


def integral(comm: MPI.Intracomm, form) -> float:
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("shape, parameters", BODIES)
def test_volumes_and_boundaries_are_those_of_the_given_mesh(comm, shape, parameters, order):
    data = made(comm, shape, order=order, **parameters)
    domain = distribute(comm, data)
    mesh = domain.mesh
    one = dolfinx.fem.Constant(mesh, 1.0)
    volume = integral(comm, one * ufl.dx(domain=mesh))
    assert volume == pytest.approx(comm.bcast(data.volumes().sum() if data else None), rel=1e-12)
    counts = comm.bcast(
        {n: int((data.facet_tags == t).sum()) for n, t in data.boundary_names.items()} if data else None
    )
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=domain.boundaries)
    straight = comm.bcast(
        {
            n: facet_measures(data.points, data.facets[data.facet_tags == t]).sum()
            for n, t in data.boundary_names.items()
        }
        if data
        else None
    )
    assert set(domain.boundary_names) == set(counts)
    for name, tag in domain.boundary_names.items():
        assert comm.allreduce(len(domain.facets(name))) == counts[name]
        curved = order == 2 and shape in ("sphere", "creature")
        assert integral(comm, one * ds(tag)) == pytest.approx(straight[name], rel=0.1 if curved else 1e-12)
    assert comm.allreduce(len(domain.facets("surface"))) == sum(counts.values())


@pytest.mark.parametrize("order", [1, 2])
def test_original_indices_lead_back_to_the_given_arrays(comm, order):
    data = made(comm, "sphere", cell_size=0.6, order=order)
    domain = distribute(comm, data)
    points, cells = comm.bcast((data.points, data.cells) if data else None)
    geometry = domain.mesh.geometry
    assert np.array_equal(geometry.x, points[np.asarray(geometry.input_global_indices)])
    every = np.concatenate(comm.allgather(domain.original_cells))
    assert np.array_equal(np.sort(every), np.arange(len(cells)))
    corners = compat.geometry_dofmap(domain.mesh, cells.shape[1])[:, :4]
    given = np.asarray(geometry.input_global_indices)[corners]
    assert np.array_equal(given, cells[domain.original_cells, :4])
    assert (domain.data is None) == (comm.rank > 0)


def two_regions() -> MeshData:
    data = generate("box", cell_size=0.3)
    right = data.points[data.corners].mean(axis=1)[:, 0] > 0.5
    return MeshData(
        **{
            **vars(data),
            "regions": np.where(right, 2, 1).astype(np.int32),
            "region_names": {"soft": 1, "hard": 2},
        }
    )


def test_regions_keep_their_names_and_volumes(comm):
    data = two_regions() if comm.rank == 0 else None
    domain = distribute(comm, data)
    dx = ufl.Measure("dx", domain=domain.mesh, subdomain_data=domain.regions)
    for name in ("soft", "hard"):
        tag = domain.region_names[name]
        exact = comm.bcast(data.volumes()[data.regions == tag].sum() if data else None)
        one = dolfinx.fem.Constant(domain.mesh, 1.0)
        assert integral(comm, one * dx(tag)) == pytest.approx(exact, rel=1e-12)
        assert comm.allreduce(len(domain.cells(name))) == comm.bcast(
            int((data.regions == tag).sum()) if data else None
        )


def test_names_can_be_united(comm):
    domain = distribute(comm, made(comm, "box", cell_size=0.4))
    both = domain.facets(["left", "right"])
    assert set(both) == set(domain.facets("left")) | set(domain.facets("right"))
    assert set(domain.facets(["surface", "left"])) == set(domain.facets("surface"))


def test_unknown_names_are_answered_with_the_nearest(comm):
    domain = distribute(comm, made(comm, "box", cell_size=0.5, dimension=2))
    with pytest.raises(MeshError) as error:
        domain.facets("lefd")
    assert str(error.value) == (
        "unknown boundary 'lefd': did you mean 'left'? accepted: left, right, bottom, top, surface"
    )
    with pytest.raises(MeshError) as error:
        domain.cells("bod")
    assert str(error.value) == "unknown region 'bod': did you mean 'body'? accepted: body"


def test_no_mesh_is_an_error_on_all_ranks(comm):
    with pytest.raises(MeshError, match="there is no mesh on rank 0 to distribute"):
        distribute(comm, None)


def test_an_interior_facet_can_have_a_name(comm):
    data = None
    if comm.rank == 0:
        points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
        cells = np.array([[0, 1, 2], [0, 2, 3]])
        data = MeshData(
            points,
            cells,
            1,
            np.ones(2, dtype=np.int32),
            np.array([[2, 0]]),
            np.ones(1, dtype=np.int32),
            {"body": 1},
            {"diagonal": 1},
        )
    domain = distribute(comm, data)
    assert comm.allreduce(len(domain.facets("diagonal")), MPI.MAX) == 1
    assert comm.allreduce(len(domain.facets("surface"))) == 4
