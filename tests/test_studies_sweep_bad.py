"""Sweeps with mistakes in them are refused in a line."""

import pytest
from square_sweep import CASE, SWEEP, write

from extremal.app import cli
from extremal.app.errors import EXIT_INPUT, InputError
from extremal.app.sweep.model import load_sweep

BAD = [
    ('scene = "square.toml"', "", "must have exactly one of scene, case"),
    ('"square.toml"', '"round.toml"', 'scene = "round.toml": no such file: {here}/round.toml'),
    ('scene = "square.toml"', 'case = "manufcatured"', "[error]: belongs to a scene; a case knows its own"),
    ("[knob]", "[knbo]", "[knob]: is missing; what is walked along each line"),
    ("values = [0.5, 0.25, 0.2]", "values = []", "[knob] values = []: must have at least one entry"),
    ("values = [0.5,", "values = [[1],", "[knob] values #1 = [1]: must be a number, a text, true or false"),
    ('name = "P2"', 'name = "P1"', '[[method]] #2 name = "P1": this name is taken; choose another'),
    (
        "diagnostic =",
        'field = "displacement"\ndiagnostic =',
        "[error]: must have exactly one of diagnostic, history, field, density, front, predictions",
    ),
    (
        "max_displacement",
        "max_displacment",
        '[error] diagnostic = "max_displacment": unknown diagnostic of elastic; did you mean max_displacement?',
    ),
    (
        'diagnostic = "max_displacement"',
        "density = 0.1",
        "[error] density = 0.1: belongs to scenes of snow; this one's part is elastic",
    ),
    (
        'diagnostic = "max_displacement"',
        'predictions = "probability"',
        "[error] predictions = \"probability\": belongs to scenes of hawkes; this one's part is elastic",
    ),
    ('set = { "mesh.cell_size" = 0.1 }', "", "[reference]: must have exactly one of set, value"),
    ("timeout = 120", "timeout = 0", "timeout = 0: must be above 0"),
    ("timeout = 120", "tiemout = 120", "tiemout = 120: unknown key; did you mean timeout?"),
    (
        "elastic_ksp_type",
        "-elastic_ksp_type",
        '[[method]] #2 petsc.-elastic_ksp_type = "gmres": the name of a PETSc option is written without the dash',
    ),
    ("[0.5, 0.25, 0.2]", "[-0.5]", "P1 at -0.5: [mesh] cell_size = -0.5: must be above 0"),
    (
        'key = "mesh.cell_size"',
        'key = "mesh.cell_sise"',
        'P1 at 0.5: [mesh] cell_sise = 0.5: unknown parameter of shape "box"; did you mean cell_size?',
    ),
    (
        "solver.tolerance = 1e-6",
        'fixed.3.boundary = "top"',
        "reference: fixed.3.boundary: 3 must be a position in the list, from 0 to 0",
    ),
    ("solver.tolerance = 1e-6", "part.what = 1", 'reference: part.what = 1: part is "elastic", not a table'),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=[new or old for old, new, _ in BAD])
def test_a_bad_sweep_is_refused_with_one_line(old, new, message, tmp_path, capsys):
    assert old in SWEEP
    sweep_file = write(tmp_path)
    sweep_file.write_text(SWEEP.replace(old, new))
    assert cli.main(["study", str(sweep_file), "-o", str(sweep_file.parent / "results")]) == EXIT_INPUT
    out, err = capsys.readouterr()
    assert out == "" and "Traceback" not in err
    assert f"extremal: {sweep_file}: {message.replace('{here}', str(sweep_file.parent))}" in err.splitlines()
    assert not (sweep_file.parent / "results").exists()


def test_settings_of_a_case_are_known(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE.replace("dimension", "dimensoin"))
    with pytest.raises(InputError, match="dimensoin = 2: unknown setting; did you mean dimension?"):
        load_sweep(path)
    path.write_text(CASE.replace('"manufactured"', '"manufcatured"'))
    with pytest.raises(InputError, match='case = "manufcatured": unknown case; did you mean manufactured?'):
        load_sweep(path)
