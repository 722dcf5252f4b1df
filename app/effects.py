"""The ledger: what a scene can switch on, what that adds, and where it stands.

`extremal check --cost` and `docs/effects.md` speak of these effects, and the tests compare them with PETSc's events and
with the libraries that runs load. What every scene of a part does is its first effect.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effect:
    """Something a scene may ask for.

    Attributes
    ----------
    part, name : str
        "any" is the part of what all scenes may have.
    keys : str
        What in a scene switches it on.
    work : str
        What it adds to a run.
    where : tuple of str
        Modules that do it.
    events : tuple of str
        PETSc events it alone has; what has none is a branch of a loop that runs anyway.
    brings : tuple of str
        Libraries and modules that are loaded only for it.
    """

    part: str
    name: str
    keys: str
    work: str
    where: tuple[str, ...]
    events: tuple[str, ...] = ()
    brings: tuple[str, ...] = ()


ELASTIC = ("energy", "residual", "tangent")
SNOW = ("grid", "to_grid", "force", "to_particles", "flow", "migrate")
PICTURES = ("matplotlib", "extremal.app.summary_page", "extremal.app.frames")
# shapes are those of bodies of snow and of colliders
OBSTACLES = ("extremal.app.colliders", "extremal.obstacles") + tuple(
    f"extremal.obstacles.{name}"
    for name in ("colliders", "deforming", "gear", "geometry", "height_field", "hollow", "motion", "samples", "shapes")
)

EFFECTS = (
    Effect(
        "any",
        "output",
        "[output] every, fields",
        "tables, and frames of all fields",
        ("app.output", "app.results"),
        ("session:output",),
    ),
    Effect(
        "any",
        "checkpoint",
        "[output] checkpoint_every",
        "the whole state to one file, twice kept",
        ("app.checkpoint",),
        ("session:checkpoint",),
    ),
    Effect("any", "summary", "[output] summary", "a picture at the end", ("app.summary",), (), PICTURES),
    # elastic
    Effect(
        "elastic",
        "elasticity",
        "[mesh], [material]",
        "Newton's method: energies, residuals, tangents, linear solves",
        ("forms.equations", "forms.newton", "forms.constitutive"),
        tuple(f"elastic:elasticity:{name}" for name in ELASTIC),
        ("dolfinx",),
    ),
    Effect(
        "elastic",
        "extension",
        "[material] extension",
        "another energy beyond the threshold, in the same loop",
        ("forms.contour", "forms.laws"),
    ),
    Effect(
        "elastic",
        "inertia",
        "[analysis] type",
        "a mass matrix; its product in each residual",
        ("forms.integrators", "forms.equations"),
        ("elastic:inertia",),
    ),
    Effect(
        "elastic",
        "damping",
        "[damping]",
        "of stiffness: a product with the last tangent in each residual; of mass: a factor of the inertia's",
        ("forms.equations",),
        ("elastic:damping",),
    ),
    Effect("elastic", "gravity", "[gravity]", "a load, assembled once", ("forms.equations",), ("elastic:gravity",)),
    Effect(
        "elastic",
        "traction",
        "[[traction]]",
        "a load on a boundary, assembled each step",
        ("forms.equations",),
        ("elastic:traction",),
    ),
    Effect(
        "elastic",
        "pressure",
        "[[pressure]]",
        "a load that follows, and its part of the tangent: GMRES instead of CG",
        ("forms.equations",),
        ("elastic:pressure",),
    ),
    Effect(
        "elastic",
        "continuation",
        "[continuation]",
        "easier solves first, where elements are inverted or a solve fails",
        ("forms.problem",),
        ("elastic:continuation",),
    ),
    Effect(
        "elastic",
        "contact",
        "[[collider]]",
        "distances of surface nodes to each collider, in each energy, residual and tangent",
        ("forms.contact", "obstacles.colliders"),
        ("elastic:contact",),
        ("extremal.forms.contacts", "extremal.forms.contact", "extremal.forms.barrier", *OBSTACLES),
    ),
    Effect(
        "elastic",
        "self_contact",
        "[contact] self",
        "pairs of close parts of the surface in each energy, residual and tangent; which of them meet, once a search",
        ("forms.self_contact", "forms.proximity", "forms.surface"),
        ("elastic:self_contact",),
        (
            "ipctk",
            "extremal.forms.contacts",
            *(f"extremal.forms.{name}" for name in ("self_contact", "proximity", "surface")),
        ),
    ),
    Effect("elastic", "bodies", "[[mesh.body]]", "more cells", ("meshes.copies",)),
    Effect(
        "elastic",
        "second_degree",
        "[element] degree",
        "unknowns on edges: about eight times as many in space",
        ("forms.space",),
    ),
    Effect(
        "elastic",
        "custom_law",
        '[material] law = "custom"',
        "an energy of one's own, compiled once",
        ("forms.symbolic",),
    ),
    Effect(
        "elastic", "unstructured_mesh", "[mesh] shape", "gmsh, once, on rank 0", ("meshes.gmsh_model",), (), ("gmsh",)
    ),
    # snow
    Effect(
        "snow",
        "snow",
        "[grid], [[body]]",
        "particles to the grid and back, forces, flow",
        ("mpm.problem", "mpm.grid"),
        tuple(f"snow:snow:{name}" for name in SNOW),
        OBSTACLES,
    ),
    Effect(
        "snow",
        "plasticity",
        '[material] law = "snow"',
        "a projection of the stretches (7.2), in the loop of the flow",
        ("mpm.law",),
    ),
    Effect(
        "snow",
        "hardening",
        "[material] hardening",
        "an exponential a particle, in the loop of the moduli",
        ("mpm.moduli",),
    ),
    Effect("snow", "gravity", "[gravity]", "an addition at each node", ("mpm.problem",)),
    Effect(
        "snow",
        "colliders",
        "[[collider]]",
        "distances of nodes and particles to each collider",
        ("mpm.colliders",),
        ("snow:colliders",),
    ),
    Effect(
        "snow",
        "implicit",
        "[analysis] beta",
        "a linear solve by CR, each iteration a pass over the particles",
        ("mpm.implicit",),
        ("snow:implicit",),
    ),
    Effect(
        "snow",
        "gradients",
        "[output] fields",
        "F_E and F_P followed for each particle: 144 bytes, an SVD a step",
        ("mpm.gradients",),
        ("snow:gradients",),
    ),
    Effect(
        "snow",
        "solid",
        "[solid]",
        "a step of an elastic body in each of the snow's, and their collisions by sweeps with a linear solve each",
        ("mpm.exchange", "forms.moving_surface", "obstacles.facets", "app.coupled"),
        ("snow:solid:step", "snow:solid:collisions"),
        (
            "dolfinx", "extremal.forms", "extremal.meshes", "extremal.app.coupled", "extremal.app.elastic",
            "extremal.app.expression", "extremal.app.keyframes", "extremal.app.shapes", "extremal.mpm.exchange",
        ),  # fmt: skip
    ),
    Effect("snow", "shell", "[[body]] shell", "factors of mass and stiffness, once", ("mpm.noise",)),
    Effect("snow", "noise", "[[body]] noise", "factors of mass and stiffness, once", ("mpm.noise",)),
    # hawkes
    Effect(
        "hawkes",
        "reconstruction",
        "[network]",
        "slots of the incomplete events, (3.5) by TAO",
        ("hawkes.reconstruct",),
        ("hawkes:reconstruction",),
    ),
    Effect("hawkes", "data", "[events]", "tables read and checked", ("app.hawkes_data",), ("hawkes:data",)),
    Effect(
        "hawkes",
        "simulation",
        "[simulation]",
        "events made up; answers scored",
        ("hawkes.simulate", "hawkes.scores"),
        ("hawkes:simulation", "hawkes:simulation:scores"),
    ),
    Effect(
        "hawkes",
        "mean_field",
        "[method] probabilities",
        "a fixed point over all slots",
        ("hawkes.meanfield",),
        ("hawkes:mean_field",),
    ),
    Effect(
        "hawkes",
        "gibbs",
        "[method] probabilities",
        "so many samples in four chains",
        ("hawkes.gibbs",),
        ("hawkes:gibbs",),
    ),
    Effect(
        "hawkes",
        "exact",
        "[method] probabilities",
        "all ways to fill in the incomplete events",
        ("hawkes.enumeration",),
        ("hawkes:exact",),
    ),
    Effect(
        "hawkes",
        "estimation",
        "[estimation]",
        "rounds of sampling and fitting, standard errors at the end",
        ("hawkes.estimate",),
        ("hawkes:estimation", "hawkes:estimation:errors"),
        ("extremal.hawkes.estimate", "extremal.hawkes.likelihood"),
    ),
)


def effect(part: str, name: str) -> Effect:
    """The effect of a name, of a part or of all parts."""
    return next(e for e in EFFECTS if e.name == name and e.part in (part, "any"))
