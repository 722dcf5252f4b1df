"""Small valid scenes, tables and meshes, for others to spoil."""

ELASTIC = """
part = "elastic"
[mesh]
shape = "box"
size = [1.0, 1.0, 1.0]
cell_size = 0.5
[material]
law = "neo_hookean"
young_modulus = 1e5
poisson_ratio = 0.3
density = 1000
extension = "c2"
threshold = 0.5
[element]
degree = 1
[[fixed]]
boundary = "left"
components = ["x", "y", "z"]
[[motion]]
boundary = "right"
displacement = ["0.1*t", 0.0, "sin(t)/10"]
[[traction]]
boundary = "top"
value = [0.0, "10*t", 0.0]
[[pressure]]
boundary = "front"
value = "10*t + x"
[gravity]
acceleration = [0.0, 0.0, -9.81]
[damping]
mass = 0.1
stiffness = 0.001
[initial]
state = "scatter"
amplitude = 0.1
seed = 3
velocity = ["x", 0.0, "-z"]
[analysis]
type = "dynamic"
integrator = "bdf2"
end_time = 0.02
time_step = 0.01
[continuation]
poisson_ratio = [0.0]
[solver]
tolerance = 1e-6
iterations = 20
[petsc]
elastic_ksp_rtol = 1e-6
[output]
every = 0.01
fields = ["displacement", "J"]
summary = false
[expect]
inverted = 0
"""
STATIC = """
[mesh]
shape = "box"
dimension = 2
size = [1.0, 1.0]
cell_size = 0.5
[material]
law = "custom"
energy = "c*(i1 - 3 - 2*log(J)) + k/2*(J - 1)**2"
young_modulus = 1e5
poisson_ratio = 0.3
parameters = { c = 2e4, k = 1e5 }
[[fixed]]
where = "x < 0.1"
[[motion]]
boundary = "right"
keyframes = [{ time = 0.0, rotation = 0.0, center = [1.0, 0.5] }, { time = 1.0, rotation = 0.2 }]
[output]
iterations = 2
summary = false
"""
SNOW = """
part = "snow"
[grid]
cell_size = 0.1
[material]
young_modulus = 1e5
hardening = 10
[[body]]
shape = "sphere"
center = [0, 0, 0.3]
radius = 0.15
per_cell = 4
velocity = [0, 0, -2]
spin = [0, 1, 0]
shell = { thickness = 0.1, stiffness = 2 }
noise = { size = 0.1, stiffness = 0.5 }
[[collider]]
shape = "half_space"
point = [0, 0, 0]
normal = [0, 0, 1]
friction = 0.5
[[collider]]
shape = "box"
low = [0.5, 0, 0]
high = [1, 1, 1]
keyframes = [{ time = 0, translation = [0, 0, 0] }, { time = 1, translation = [-0.1, 0, 0] }]
[gravity]
acceleration = [0, 0, -9.81]
[analysis]
end_time = 2e-3
time_step = 1e-3
beta = 1
[output]
every = 1e-3
fields = ["velocity", "J_P"]
summary = false
"""
FLAT_SNOW = """
part = "snow"
[grid]
cell_size = 0.1
dimension = 2
spline = "quadratic"
[[body]]
shape = "height_field"
low = [0, 0]
high = [1, 1]
surface = "0.3 + 0.1*sin(5*x)"
[analysis]
end_time = 2e-3
time_step = 1e-3
beta = 0
[output]
summary = false
"""
HAWKES = """
part = "hawkes"
[network]
agents = 5
background = 0.01
branching = 0.5
decay = 0.1
[simulation]
count = 60
incomplete = 20
missing = "one"
seed = 2
[estimation]
rounds = 2
[method]
gap = 1e-6
sweeps = 2
probabilities = "gibbs"
samples = 10
[output]
candidates = 3
summary = false
[expect]
gap = { below = 1e-6 }
"""
TABLES = """
part = "hawkes"
[network]
file = "network.csv"
[events]
file = "events.csv"
unit = "days"
[method]
probabilities = "none"
[output]
summary = false
"""
NETWORK = "first,second,background,branching,decay\n" + "".join(
    f"{a},{b},0.01,0.5,0.{1 + k % 3}\n"
    for k, (a, b) in enumerate([("ann", "bob"), ("bob", "cy"), ("cy", "dee"), ("ann", "dee")])
)
EVENTS = "time,first,second\n" + "".join(
    f"2024-01-{day:02d}T10:{5 * day % 60:02d},{a},{b}\n"
    for day, (a, b) in enumerate(
        [("ann", "bob"), ("bob", ""), ("cy", "dee"), ("", "cy"), ("ann", "dee"), ("?", "?")] * 3, 1
    )
)
MESH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
1 7 "left"
2 9 "soft"
$EndPhysicalNames
$Nodes
5
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
5 0.5 0.5 0
$EndNodes
$Elements
5
1 1 2 7 1 4 1
2 2 2 9 1 1 2 5
3 2 2 9 1 2 3 5
4 2 2 9 1 3 4 5
5 2 2 9 1 4 1 5
$EndElements
"""
SURFACE = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 2 3 4
f 1 4 3
"""
STL = (
    "solid s\n"
    + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {' '.join(map(str, v))}\n" for v in face)
        + "endloop\nendfacet\n"
        for face in [
            ((0, 0, 0), (0, 1, 0), (1, 0, 0)),
            ((0, 0, 0), (1, 0, 0), (0, 0, 1)),
            ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
            ((0, 0, 0), (0, 0, 1), (0, 1, 0)),
        ]
    )
    + "endsolid s\n"
)
VTU = """<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="4" NumberOfCells="1"><Points>
<DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points><Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4</DataArray>
<DataArray type="Int64" Name="types" format="ascii">10</DataArray>
</Cells></Piece></UnstructuredGrid></VTKFile>
"""
MESHES = {"body.msh": MESH, "body.obj": SURFACE, "body.stl": STL, "body.vtu": VTU}
