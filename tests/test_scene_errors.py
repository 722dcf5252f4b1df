"""A bad scene is refused with exactly one plain line for each thing wrong, and nothing is written."""

from pathlib import Path

import pytest

from extremal.app.errors import InputError
from extremal.app.scene import read_scene

# what a case does not give itself
MESH = '[mesh]\nshape = "box"\ncell_size = 0.5\n'
MATERIAL = "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\n"

# (scene, one line for each error)
CASES: list[tuple[str, ...]] = [
    (
        '"two\\nlines" = 1',
        '"two\\nlines" = 1: unknown key; known: title, part, mesh, material, regions, element, fixed, motion, '
        "traction, pressure, gravity, damping, initial, analysis, continuation, solver, petsc, output, expect",
    ),
    ("title = 1979-05-27", "title = 1979-05-27: must be text in quotes"),
    (
        "[solver]\ntolerance = 1" + "0" * 400,
        "[solver] tolerance = 1" + "0" * 55 + " ...: must be a finite number",
    ),
    ("[solver]\niterations = 2000000", "[solver] iterations = 2000000: must be at most 1e+06"),
    (
        "title = 3",
        "title = 3: must be text in quotes",
    ),
    (
        'titel = "x"',
        'titel = "x": unknown key; did you mean title?',
    ),
    (
        'part = "elastics"',
        'part = "elastics": must be "elastic"',
    ),
    (
        'part = "snow"',
        'part = "snow": must be "elastic"',
    ),
    (
        "mesh = 3",
        "mesh = 3: must be a table",
    ),
    (
        '[mesh]\nshape = "bxo"',
        '[mesh] shape = "bxo": unknown shape; did you mean box?',
    ),
    (
        '[mesh]\nshape = "box"\nsizes = [1,1,1]',
        '[mesh] sizes = [1, 1, 1]: unknown parameter of shape "box"; did you mean size?',
    ),
    (
        '[mesh]\nshape = "box"\nfile = "a.msh"',
        '[mesh] file = "a.msh": given together with shape; leave one of them out',
    ),
    (
        "[mesh]\ncell_size = 0.1",
        '[mesh] shape: is missing; give a shape as shape = "box" or a mesh file as file = "body.msh"',
    ),
    (
        '[mesh]\nfile = "a.geo"',
        '[mesh] file = "a.geo": gmsh scripts can run commands and are refused; give the mesh (.msh) made '
        "from it",
    ),
    (
        '[mesh]\nfile = "a.msh"\nsize = 3',
        "[mesh] size = 3: unknown key for a mesh file; did you mean cell_size?",
    ),
    (
        '[mesh]\nshape = "box"\ncell_size = -0.1',
        "[mesh] cell_size = -0.1: must be above 0",
    ),
    (
        '[mesh]\nshape = "box"\ncell_size = "small"',
        '[mesh] cell_size = "small": must be a number',
    ),
    (
        '[mesh]\nshape = "box"\norder = 3',
        "[mesh] order = 3: must be 1 or 2",
    ),
    (
        '[mesh]\nshape = "box"\ncell_size = nan',
        "[mesh] cell_size = nan: must be a finite number",
    ),
    (
        "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.7",
        "[material] poisson_ratio = 0.7: must be above -1 and below 0.5 (nearly incompressible: 0.499)",
    ),
    (
        "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.5",
        "[material] poisson_ratio = 0.5: must be above -1 and below 0.5 (nearly incompressible: 0.499)",
    ),
    (
        "[material]\nyoung_modulus = -1\npoisson_ratio = 0.3",
        "[material] young_modulus = -1: must be above 0",
    ),
    (
        "[material]\nyung_modulus = 1\npoisson_ratio = 0.3",
        "[material] yung_modulus = 1: unknown key; did you mean young_modulus?",
    ),
    (
        "[material]\nyoung_modulus = true\npoisson_ratio = 0.3",
        "[material] young_modulus = true: must be a number or an expression of x, y, z in quotes",
    ),
    (
        "[material]\nyoung_modulus = inf\npoisson_ratio = 0.3",
        "[material] young_modulus = inf: must be a finite number",
    ),
    (
        '[material]\nyoung_modulus = "1e5*(1+x"\npoisson_ratio = 0.3',
        "[material] young_modulus = \"1e5*(1+x\": column 5: '(' is never closed",
    ),
    (
        '[material]\nyoung_modulus = "1e5*q"\npoisson_ratio = 0.3',
        "[material] young_modulus = \"1e5*q\": column 5: unknown name 'q'; known: x, y, z, pi, e",
    ),
    (
        "[material]\nyoung_modulus = 1e5",
        "[material] poisson_ratio: is missing; young_modulus alone does not determine the material",
    ),
    (
        "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nshear_modulus = 1\nlame_lambda = 2",
        "[material] shear_modulus = 1: given together with young_modulus; give young_modulus and "
        "poisson_ratio, or shear_modulus and lame_lambda, not some of each",
    ),
    (
        "[material]\nyoung_modulus = 1e5\nlame_lambda = 2",
        "[material] lame_lambda = 2: given together with young_modulus; give young_modulus and "
        "poisson_ratio, or shear_modulus and lame_lambda, not some of each",
    ),
    (
        "[material]\nshear_modulus = 3\nlame_lambda = -3",
        "[material] lame_lambda = -3: must be above -2/3 shear_modulus = -2 for a stable material",
    ),
    (
        "[material]",
        "[material] young_modulus: is missing; give young_modulus and poisson_ratio, or shear_modulus "
        "and lame_lambda",
    ),
    (
        '[material]\nlaw = "neohookean"\nyoung_modulus = 1e5\npoisson_ratio = 0.3',
        '[material] law = "neohookean": did you mean "neo_hookean"? must be "neo_hookean", "corotated", '
        '"fixed_corotated", "st_venant_kirchhoff", "mooney_rivlin" or "custom"',
    ),
    (
        "[material]\nlaw = 3\nyoung_modulus = 1e5\npoisson_ratio = 0.3",
        '[material] law = 3: must be "neo_hookean", "corotated", "fixed_corotated", '
        '"st_venant_kirchhoff", "mooney_rivlin" or "custom"',
    ),
    (
        '[material]\nlaw = "custom"',
        '[material] energy: is missing; law = "custom" needs an energy as an expression of i1, i2, J',
    ),
    (
        '[material]\nlaw = "custom"\nenergy = "a*(i1-d)**2 + J.b"\nparameters = {a = 1}',
        '[material] energy = "a*(i1-d)**2 + J.b": column 15: only numbers, names, + - * / **, '
        "comparisons and functions are known",
    ),
    (
        '[material]\nlaw = "custom"\nenergy = "a*(I1-d)"',
        "[material] energy = \"a*(I1-d)\": column 1: unknown name 'a'; known: i1, i2, J, I1, I2, s1, s2, "
        "s3, d, pi, e",
    ),
    (
        '[material]\nlaw = "custom"\nenergy = "a*(I1-d)"\nparameters = {a = 1, b=2}',
        "[material] parameters.b = 2: is not used by the energy; known: I1, a, d",
    ),
    (
        '[material]\nlaw = "custom"\nenergy = "a*s1 + i1"\nparameters = {a = 1}',
        '[material] energy = "a*s1 + i1": mixes stretches s1, s2, s3 with invariants; use one kind (J '
        "goes with both)",
    ),
    (
        '[material]\nlaw = "custom"\nenergy = "a*3"\nparameters = {a = 1}',
        '[material] energy = "a*3": depends on no deformation; use i1, i2, J or I1, I2, J or s1, s2, s3',
    ),
    (
        '[material]\nlaw = "custom"\nenergy = "J*J"\nparameters = {J = 1}',
        "[material] parameters.J = 1: this name is taken; choose another for the parameter",
    ),
    (
        '[material]\nlaw = "custom"\nenergy = "9**9**9*J"',
        '[material] energy = "9**9**9*J": column 4: a power is at most 1000 in size, this one is 3.8742e+08',
    ),
    (
        '[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nlaw="neo_hookean"\nenergy = "J"',
        '[material] energy = "J": belongs to law = "custom", but law is "neo_hookean"',
    ),
    (
        '[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nenergy = "J"',
        '[material] energy = "J": belongs to law = "custom", but law is "neo_hookean"',
    ),
    (
        "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nc1=3",
        '[material] c1 = 3: belongs to law = "mooney_rivlin", but law is "neo_hookean"',
    ),
    (
        '[material]\nlaw = "mooney_rivlin"\nc1 = 1',
        "[material] c2: is missing; mooney_rivlin takes both c1 and c2, or neither",
        "[material] poisson_ratio: is missing; c1 and c2 need poisson_ratio or lame_lambda beside them",
    ),
    (
        '[material]\nlaw = "mooney_rivlin"\nc1 = 1\nc2 = 2\nyoung_modulus = 2\npoisson_ratio=0.3',
        "[material] young_modulus = 2: is determined by c1 and c2 (μ = 2 (c1 + c2)); leave one of them out",
    ),
    (
        '[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nextension = "C2"',
        '[material] extension = "C2": did you mean "c2"? must be "none", "c1", "c2" or "ife"',
    ),
    (
        '[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nextension = "c2"\nstiffness = 3',
        '[material] stiffness = 3: belongs to extension = "c1", but extension is "c2"',
    ),
    (
        "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nstiffness = 3",
        '[material] stiffness = 3: belongs to extension = "c1", but extension is "c2"',
    ),
    (
        '[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nextension = "none"\nthreshold = 0.3',
        '[material] threshold = 0.3: has no meaning with extension = "none"; leave one of them out',
    ),
    (
        "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\nthreshold = 1.2",
        "[material] threshold = 1.2: must be above 0 and below 1: the body at rest may not be in the "
        "extension",
    ),
    (
        "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\ndensity = 0",
        "[material] density = 0: must be above 0",
    ),
    (
        "[regions.soft]\npoisson_ratio = 0.6",
        "[regions.soft] poisson_ratio = 0.6: must be above -1 and below 0.5 (nearly incompressible: 0.499)",
    ),
    (
        "[regions.soft]\npoison_ratio = 0.4",
        "[regions.soft] poison_ratio = 0.4: unknown key; did you mean poisson_ratio?",
    ),
    (
        "[regions.soft]\nshear_modulus = 3",
        "[regions.soft] shear_modulus = 3: given together with young_modulus; give young_modulus and "
        "poisson_ratio, or shear_modulus and lame_lambda, not some of each (with what [material] gives)",
    ),
    (
        "[regions]\nsoft = 3",
        "[regions.soft] = 3: must be a table",
    ),
    (
        "[element]\ndegree = 3",
        "[element] degree = 3: must be 1 or 2",
    ),
    (
        '[element]\nvolumetric = "reduced"',
        '[element] volumetric = "reduced": must be "standard" or "projected"',
    ),
    (
        '[fixed]\nboundary = "left"',
        "[fixed]: may be given several times; write [[fixed]]",
    ),
    (
        "[[fixed]]",
        '[[fixed]] #1 boundary: is missing; give boundary = "name" or where = "z < 0.01"',
    ),
    (
        '[[fixed]]\nboundary = "left"\nwhere = "x<0.1"',
        '[[fixed]] #1 where = "x<0.1": given together with boundary; leave one of them out',
    ),
    (
        '[[fixed]]\nwhere = "x"',
        '[[fixed]] #1 where = "x": is not a comparison; write one as "z < 0.01"',
    ),
    (
        '[[fixed]]\nwhere = "x < q"',
        "[[fixed]] #1 where = \"x < q\": column 5: unknown name 'q'; known: x, y, z, pi, e",
    ),
    (
        "[[fixed]]\nwhere = 3",
        '[[fixed]] #1 where = 3: must be a comparison of x, y, z in quotes, as "z < 0.01"',
    ),
    (
        "[[fixed]]\nboundary = []",
        '[[fixed]] #1 boundary = []: must be a name or a list of names, as "left" or ["left", "right"]',
    ),
    (
        '[[fixed]]\nboundary = "left"\ncomponents = ["x","w"]',
        '[[fixed]] #1 components #2 = "w": must be "x", "y" or "z"',
    ),
    (
        '[[fixed]]\nboundary = "left"\ncomponents = []',
        "[[fixed]] #1 components = []: must have at least one entry",
    ),
    (
        '[[fixed]]\nboundary = "left"\ncomponents = "x"',
        '[[fixed]] #1 components = "x": must be a list',
    ),
    (
        '[[fixed]]\nboundary = "left"\n[[fixed]]\nbondary = "right"',
        '[[fixed]] #2 bondary = "right": unknown key; did you mean boundary?',
    ),
    (
        '[[motion]]\nboundary = "left"',
        "[[motion]] #1 displacement: is missing; give displacement = [..] or keyframes = [..]",
    ),
    (
        '[[motion]]\nboundary = "left"\ndisplacement = [1,2,3]\nkeyframes = [{time=0}]',
        "[[motion]] #1 keyframes = [{time = 0}]: given together with displacement; leave one of them out",
    ),
    (
        '[[motion]]\nboundary = "left"\ndisplacement = ["free","",""]',
        '[[motion]] #1 displacement = ["free", "", ""]: leaves every component free; prescribe one or '
        "leave the motion out",
    ),
    (
        '[[motion]]\nboundary = "left"\ndisplacement = [0, "sin(t", 0]',
        "[[motion]] #1 displacement #2 = \"sin(t\": column 4: '(' is never closed",
    ),
    (
        '[[motion]]\nboundary = "left"\ndisplacement = [0, 1]',
        "[[motion]] #1 displacement = [0, 1]: must have 3 components: the body is 3-dimensional",
    ),
    (
        '[[motion]]\nboundary = "left"\ndisplacement = [0, 1,2,3]',
        "[[motion]] #1 displacement = [0, 1, 2, 3]: has 4 entries; must be a list of 2 or 3 numbers, "
        'expressions of x, y, z, t or "free"',
    ),
    (
        '[[motion]]\nboundary = "left"\ndisplacement = "x"',
        '[[motion]] #1 displacement = "x": must be a list of 2 or 3 numbers, expressions of x, y, z, t '
        'or "free"',
    ),
    (
        '[[motion]]\nboundary = "left"\ndisplacement = [0, [1], 0]',
        "[[motion]] #1 displacement #2 = [1]: must be a number or an expression of x, y, z, t in quotes "
        'or "free"',
    ),
    (
        '[[motion]]\nboundary = "left"\nkeyframes = [{time=0},{time=1,translation=[1,0,0]},{time=1}]',
        "[[motion]] #1 keyframes #3 time = 1: must be above the time of the keyframe before it, 1",
    ),
    (
        '[[motion]]\nboundary = "left"\nkeyframes = [{translation=[1,0,0]}]',
        "[[motion]] #1 keyframes #1 time: is missing; time [s] or load parameter",
    ),
    (
        '[[motion]]\nboundary = "left"\nkeyframes = [{time=0, rotation=0.3}]',
        "[[motion]] #1 keyframes #1 rotation = 0.3: must be a rotation vector of 3 entries: the body is "
        "3-dimensional",
    ),
    (
        '[[motion]]\nboundary = "left"\nkeyframes = [{time=0, rotation=[0.3,1]}]',
        "[[motion]] #1 keyframes #1 rotation = [0.3, 1]: must be a rotation vector of 3 entries [rad], "
        "or one angle in the plane",
    ),
    (
        '[[motion]]\nboundary = "left"\nkeyframes = []',
        "[[motion]] #1 keyframes = []: must have at least one entry",
    ),
    (
        '[[traction]]\nboundary = "left"',
        "[[traction]] #1 value: is missing; force per reference area [Pa], expressions of x, y, z, t",
    ),
    (
        '[[traction]]\nboundary = "left"\nvalue = [1e5, "x**y**z**", 0]',
        '[[traction]] #1 value #2 = "x**y**z**": ends too early',
    ),
    (
        '[[pressure]]\nboundary = "left"\nvalue = "t*sine(x)"',
        "[[pressure]] #1 value = \"t*sine(x)\": column 3: unknown function 'sine'; did you mean sin?",
    ),
    (
        '[[pressure]]\nboundary = "left"\nvalue = [1]',
        "[[pressure]] #1 value = [1]: must be a number or an expression of x, y, z, t in quotes",
    ),
    (
        "[gravity]\nacceleration = [0,0,-9.81]",
        "[material] density: is missing; [gravity] needs it [kg/m3]",
    ),
    (
        "[gravity]",
        "[gravity] acceleration: is missing; acceleration [m/s2], as [0, 0, -9.81]",
    ),
    (
        "[gravity]\nacceleration = -9.81",
        "[gravity] acceleration = -9.81: must be a list of 2 or 3 numbers",
    ),
    (
        "[[gravity]]\nacceleration = [0,0,-9.81]",
        "[[gravity]]: may be given once only; write [gravity]",
    ),
    (
        '[gravity]\nacceleration = [0,0,"-9.81"]',
        '[gravity] acceleration #3 = "-9.81": must be a number',
    ),
    (
        "[damping]\nmass = 1",
        '[damping]: needs [analysis] type = "dynamic"',
    ),
    (
        '[damping]\n[analysis]\ntype = "dynamic"',
        "[damping] mass: is missing; give mass [1/s] or stiffness [s] above 0, or leave [damping] out",
        '[material] density: is missing; type = "dynamic" needs it [kg/m3]',
    ),
    (
        '[analysis]\ntype = "dynamic"',
        '[material] density: is missing; type = "dynamic" needs it [kg/m3]',
    ),
    (
        '[initial]\nstate = "scattered"',
        '[initial] state = "scattered": did you mean "scatter"? must be "rest", "scatter", "collapse" or '
        '"mirror"',
    ),
    (
        '[initial]\nstate = "scatter"\nnoise = 0.1',
        '[initial] noise = 0.1: belongs to state = "collapse", but state is "scatter"',
    ),
    (
        "[initial]\nseed = -1",
        "[initial] seed = -1: must be at least 0",
    ),
    (
        '[initial]\nstate="scatter"\nseed = 1.5',
        "[initial] seed = 1.5: must be a whole number",
    ),
    (
        '[initial]\nstate="scatter"\namplitude = 0',
        "[initial] amplitude = 0: must be above 0",
    ),
    (
        '[initial]\nstate = "collapse"\naxis = "x"',
        '[initial] axis = "x": belongs to to = "line" or "plane", but to is "point"',
    ),
    (
        "[initial]\nvelocity = [1,0,0]",
        '[initial] velocity = [1, 0, 0]: needs [analysis] type = "dynamic"',
    ),
    (
        '[analysis]\ntype = "quasistatic"',
        '[analysis] type = "quasistatic": did you mean "static"? must be "static" or "dynamic"',
    ),
    (
        "[analysis]\nend_time = 0",
        "[analysis] end_time = 0: must be above 0",
    ),
    (
        "[analysis]\ntime_step = 2",
        "[analysis] time_step = 2: must not be above end_time = 1",
    ),
    (
        "[analysis]\ntime_step = 0.1\nsmallest_step = 0.2",
        "[analysis] smallest_step = 0.2: must not be above time_step = 0.1",
    ),
    (
        "[analysis]\ntime_step = 0.1\nlargest_step = 0.01",
        "[analysis] largest_step = 0.01: must not be below time_step = 0.1",
    ),
    (
        '[analysis]\nintegrator = "newmark"',
        '[analysis] integrator = "newmark": belongs to type = "dynamic", but type is "static"',
    ),
    (
        '[analysis]\nadaptive = "yes"',
        '[analysis] adaptive = "yes": must be true or false',
    ),
    (
        "[continuation]",
        "[continuation] poisson_ratio: is missing; give stages as poisson_ratio = [0.3], or leave "
        "[continuation] out",
    ),
    (
        "[continuation]\npoisson_ratio = [0.3, 0.4]",
        "[continuation] poisson_ratio #1 = 0.3: must be below [material] poisson_ratio = 0.3",
        "[continuation] poisson_ratio #2 = 0.4: must be below [material] poisson_ratio = 0.3",
    ),
    (
        "[continuation]\npoisson_ratio = 0.3",
        "[continuation] poisson_ratio = 0.3: must be a list",
    ),
    (
        "[continuation]\nthreshold = [1.5]",
        "[continuation] threshold #1 = 1.5: must be below 1",
    ),
    (
        "[solver]\ntolerance = 1",
        "[solver] tolerance = 1: must be below 1",
    ),
    (
        "[solver]\niterations = 0",
        "[solver] iterations = 0: must be at least 1",
    ),
    (
        "[solver]\niterations = 10.5",
        "[solver] iterations = 10.5: must be a whole number",
    ),
    (
        '[solver]\ntangent = "exakt"',
        '[solver] tangent = "exakt": did you mean "exact"? must be "projected" or "exact"',
    ),
    (
        '[petsc]\n"-elastic_ksp_type" = "cg"',
        '[petsc] -elastic_ksp_type = "cg": the name of a PETSc option is written without the dash',
    ),
    (
        '[petsc]\n"elastic ksp" = "cg"',
        '[petsc] "elastic ksp" = "cg": the name of a PETSc option is written with letters, digits and _ only',
    ),
    (
        '[petsc]\nelastic_ksp_type = ["cg"]',
        '[petsc] elastic_ksp_type = ["cg"]: must be text, a number, true or false',
    ),
    (
        "[output]\nevery = 3",
        "[output] every = 3: must not be above [analysis] end_time = 1",
    ),
    (
        '[output]\nfields = ["J", "vonmises"]',
        '[output] fields #2 = "vonmises": did you mean "von_mises"? must be "J", "smallest_stretch", '
        '"von_mises", "energy_density", "inverted", "region", "displacement" or "velocity"',
    ),
    (
        "[output]\n"
        "iterations = 5\n"
        "[analysis]\n"
        'type = "dynamic"\n'
        "[material]\n"
        "young_modulus=1\n"
        "poisson_ratio=0.1\n"
        "density=1",
        '[output] iterations = 5: needs [analysis] type = "static"',
    ),
    (
        "[expect]\nresidual = {}",
        "[expect] residual = {}: must be a number, or say value, below or above, as { below = 1e-6 }",
    ),
    (
        "[expect]\nresidul = 3",
        "[expect] residul = 3: unknown diagnostic; did you mean residual?",
    ),
    (
        '[expect]\nresidual = "small"',
        '[expect] residual = "small": must be a number, not text',
    ),
    (
        '[expect]\nstatus = "done"',
        '[expect] status = "done": must be "finished", "stopped" or "failed"',
    ),
    (
        "[expect]\nresidual = {belov = 1e-6}",
        "[expect] residual.belov = 1e-06: unknown key; did you mean below?",
    ),
    (
        '[expect]\nresidual = {below = "1e-6"}',
        '[expect] residual.below = "1e-6": must be a number',
    ),
    (
        "[expect]\ninverted = true",
        "[expect] inverted = true: must be a number, or say value, below or above, as { below = 1e-6 }",
    ),
    (
        "[expect]\ninverted = {tolerance = 1}",
        "[expect] inverted = {tolerance = 1}: must be a number, or say value, below or above, as { below "
        "= 1e-6 }",
    ),
]

# the same, without a mesh and a material added
BARE: list[tuple[str, ...]] = [
    (
        '[mesh]\nshape = "box',
        "line 2, column 13: not TOML: Illegal character '\\n'",
    ),
    (
        'title = "a"\ntitle = "b"',
        "line 2, column 12: not TOML: Cannot overwrite a value",
    ),
    (
        "x = [1,",
        "line 2, at the end: not TOML: Invalid value",
    ),
    (
        "a = 1 b = 2",
        "line 1, column 7: not TOML: Expected newline or end of document after a statement",
    ),
    (
        '[mesh]\nshape = "box"',
        "[material]: is missing; the material, everywhere unless a region overrides it",
    ),
    (
        "[material]\nyoung_modulus = 1\npoisson_ratio = 0.3",
        "[mesh]: is missing; the body",
    ),
]


def refusal(path: Path, text: str) -> list[str]:
    """The lines with which a scene is refused, without the file's name."""
    path.write_text(text, encoding="utf-8")
    before = sorted(path.parent.iterdir())
    with pytest.raises(InputError) as caught:
        read_scene(path)
    assert sorted(path.parent.iterdir()) == before
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in caught.value.messages)
    return [line.removeprefix(f"{path}: ") for line in caught.value.messages]


def completed(text: str) -> str:
    """A scene with a mesh and a material if it has none; after its own tables, so that line numbers stay."""
    if "[mesh]" not in text and not text.startswith("mesh"):
        text += "\n" + MESH
    return text if "[material]" in text else text + "\n" + MATERIAL


@pytest.mark.parametrize("case", CASES, ids=[case[0] for case in CASES])
def test_bad_scene_is_refused_in_plain_words(case: tuple[str, ...], tmp_path: Path) -> None:
    text, *messages = case
    assert refusal(tmp_path / "scene.toml", completed(text)) == messages


@pytest.mark.parametrize("case", BARE, ids=[case[0] for case in BARE])
def test_bad_file_is_refused_in_plain_words(case: tuple[str, ...], tmp_path: Path) -> None:
    text, *messages = case
    assert refusal(tmp_path / "scene.toml", text + "\n") == messages


def test_there_are_at_least_sixty_distinct_messages() -> None:
    assert len({message for case in CASES + BARE for message in case[1:]}) >= 60


def test_all_errors_of_a_scene_are_reported_at_once(tmp_path: Path) -> None:
    text = """
        [mesh]
        shape = "box"
        [material]
        young_modulus = -1
        poisson_ratio = 0.7
        [gravity]
        acceleration = [1, 2]
        [solver]
        tolerance = -1
        iteration = 3
        [damping]
        mass = 1
    """
    assert refusal(tmp_path / "scene.toml", text) == [
        "[material] poisson_ratio = 0.7: must be above -1 and below 0.5 (nearly incompressible: 0.499)",
        "[material] young_modulus = -1: must be above 0",
        "[solver] tolerance = -1: must be above 0",
        "[solver] iteration = 3: unknown key; did you mean iterations?",
        '[damping]: needs [analysis] type = "dynamic"',
        "[gravity] acceleration = [1, 2]: must have 3 components: the body is 3-dimensional",
    ]


def test_a_plane_scene_with_components_of_space_is_refused(tmp_path: Path) -> None:
    text = """
        [mesh]
        shape = "box"
        dimension = 2
        [material]
        law = "custom"
        energy = "J*s3"
        density = 1
        [gravity]
        acceleration = [0, 0, -9.81]
        [[fixed]]
        boundary = "left"
        components = ["x", "z"]
        [[traction]]
        boundary = "left"
        value = [0, 0, 1]
        [[motion]]
        boundary = "right"
        keyframes = [{ time = 0, rotation = [0, 1, 0] }]
        [initial]
        state = "mirror"
        axis = "z"
    """
    assert refusal(tmp_path / "scene.toml", text) == [
        "[[motion]] #1 keyframes #1 rotation = [0, 1, 0]: must be one angle [rad], or [0, 0, angle]: "
        "the body is 2-dimensional",
        "[[traction]] #1 value = [0, 0, 1]: must have 2 components: the body is 2-dimensional",
        "[gravity] acceleration = [0, 0, -9.81]: must have 2 components: the body is 2-dimensional",
        '[[fixed]] #1 components = ["x", "z"]: has no "z": the body is 2-dimensional',
        '[initial] axis = "z": must be "x" or "y": the body is 2-dimensional',
        '[material] energy = "J*s3": s3 does not exist in 2 dimensions; use i1, J, I1 or s1, s2',
    ]


def test_a_mesh_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    lines = refusal(tmp_path / "scene.toml", '[mesh]\nfile = "body.msh"\n' + MATERIAL)
    assert lines == [f'[mesh] file = "body.msh": no such file: {tmp_path / "body.msh"}']


def test_a_scene_that_is_not_a_readable_file_is_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b'title = "a"\nb = "\xff"\n')
    deep = tmp_path / "deep.toml"
    deep.write_text("a = " + "[" * 5000)
    for path, message in (
        (tmp_path / "none.toml", "no such file"),
        (tmp_path, "is a folder; give a scene file"),
        (binary, "line 2: is not UTF-8 text"),
        (deep, "is nested too deeply for a scene"),
    ):
        with pytest.raises(InputError) as caught:
            read_scene(path)
        assert caught.value.messages == (f"{path}: {message}",)
