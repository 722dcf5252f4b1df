"""Runs a minimal scene of a part, then the scene with one effect more, each in turn: `effects_runs.py PART`.

Prints as JSON, for each run: PETSc's events that ran and how often, the libraries it was the first to load, the effects
that run.json lists, and the arrays that a state holds.
"""

from __future__ import annotations

import copy
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from extremal.app import checkpoint
from extremal.app.scene_errors import literal

Tables = dict[str, Any]
PLAIN: dict[str, Tables] = {
    "elastic": {
        "mesh": {"shape": "box", "size": [1, 1, 1], "cell_size": 0.5, "structured": True},
        "material": {"law": "neo_hookean", "young_modulus": 1e5, "poisson_ratio": 0.3, "extension": "none"},
        "motion": [{"boundary": "left", "displacement": [0, 0, 0]}],
        "output": {"summary": False},
    },
    "snow": {
        "part": "snow",
        "grid": {"cell_size": 0.1},
        "material": {"law": "fixed_corotated"},
        "body": [{"shape": "sphere", "center": [0, 0, 0.3], "radius": 0.15, "velocity": [0, 0, -1]}],
        "analysis": {"end_time": 2e-3, "time_step": 1e-3, "beta": 0},
        "output": {"summary": False, "fields": []},
    },
    "hawkes": {
        "part": "hawkes",
        "network": {"agents": 5},
        "simulation": {"count": 60, "incomplete": 8, "seed": 2},
        "method": {"probabilities": "none"},
        "output": {"summary": False},
    },
}
DYNAMIC = {"analysis": {"type": "dynamic", "end_time": 0.02, "time_step": 0.01}, "material": {"density": 1000}}
# what is changed in the tables to switch an effect on; those that need inertia are compared with it
WITH: dict[str, dict[str, Tables]] = {
    "elastic": {
        "extension": {"material": {"extension": "c2"}},
        "gravity": {"gravity": {"acceleration": [0, 0, -9.81]}, "material": {"density": 1000}},
        "traction": {"traction": [{"boundary": "right", "value": [100, 0, 0]}]},
        "pressure": {"pressure": [{"boundary": "right", "value": 100}]},
        "continuation": {
            "continuation": {"poisson_ratio": [0]},
            "initial": {"state": "mirror"},
            "material": {"extension": "c2"},
        },
        "contact": {"collider": [{"shape": "half_space", "point": [0, 0, -0.01], "normal": [0, 0, 1]}]},
        "self_contact": {"contact": {"self": True}},
        "bodies": {"mesh": {"body": [{}, {"translation": [1.5, 0, 0]}]}},
        "inertia": DYNAMIC,
        "damping": {**DYNAMIC, "damping": {"stiffness": 1e-3}},
        "second_degree": {"element": {"degree": 2}},
        "unstructured_mesh": {"mesh": {"structured": False}},
        "custom_law": {"material": {"law": "custom", "energy": "mu/2*(i1 - 3) - mu*log(J) + lam/2*(J-1)**2"}},
        "summary": {"output": {"summary": True}},
    },
    "snow": {
        "plasticity": {"material": {"law": "snow", "hardening": 0}},
        "hardening": {"material": {"law": "snow"}},
        "gravity": {"gravity": {"acceleration": [0, 0, -9.81]}},
        "colliders": {"collider": [{"shape": "half_space", "point": [0, 0, 0], "normal": [0, 0, 1]}]},
        "implicit": {"analysis": {"beta": 1}},
        "solid": {
            "solid": {
                "mesh": {"shape": "box", "size": [0.2, 0.2, 0.1], "cell_size": 0.1, "structured": True},
                "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000, "extension": "none"},
                "velocity": [0, 0, 1],
            }
        },
        "gradients": {"output": {"fields": ["elastic_gradient"]}},
        "shell": {"body": [{"shell": {"thickness": 0.1}}]},
        "noise": {"body": [{"noise": {"size": 0.1}}]},
        "summary": {"output": {"summary": True}},
    },
    "hawkes": {
        "mean_field": {"method": {"probabilities": "mean_field"}},
        "gibbs": {"method": {"probabilities": "gibbs", "samples": 20}},
        "exact": {"method": {"probabilities": "exact"}},
        "estimation": {"estimation": {"rounds": 3}},
        "summary": {"output": {"summary": True}},
    },
}


def merged(plain: Any, change: Any) -> Any:
    """Tables and lists of tables with what `change` says."""
    if isinstance(plain, dict) and isinstance(change, dict):
        return {**plain, **{key: merged(plain.get(key), value) for key, value in change.items()}}
    if isinstance(plain, list) and isinstance(change, list) and plain and isinstance(plain[0], dict):
        return [merged(a, b) for a, b in zip(plain, change)]
    return copy.deepcopy(change)


def libraries() -> set[str]:
    """Those loaded, and modules of ours."""
    names = {name if name.startswith("extremal.") else name.partition(".")[0] for name in sys.modules}
    return {name for name in names if not name.startswith("_") and name not in sys.stdlib_module_names}


def main() -> None:
    """Run all scenes of a part."""
    from extremal.app import cli

    part = sys.argv[1]
    found: dict[str, Any] = {}
    events: dict[str, int] = {}
    for name, change in {"plain": {}, **WITH[part]}.items():
        with tempfile.TemporaryDirectory() as place:
            scene, out = Path(place) / "scene.toml", Path(place) / "out"
            tables = merged(PLAIN[part], change)
            scene.write_text("".join(f"{key} = {literal(value)}\n" for key, value in tables.items()))
            before = libraries()
            code = cli.main([part, str(scene), "-o", str(out), "--quiet"])
            record = json.loads((out / "run.json").read_text())
            now = {event: figures["calls"] for event, figures in record["events"].items()}
            state = checkpoint.load(checkpoint.list_checkpoints(out)[0]).state
            found[name] = {
                "code": code,
                "events": sorted(event for event, calls in now.items() if calls > events.get(event, 0)),
                "libraries": sorted(libraries() - (before if name != "plain" else set())),
                "effects": sorted(record["effects"]),
                "arrays": {key: int(values.size) for key, values in state.items()},
            }
            events = now
    print(json.dumps(found))


if __name__ == "__main__":
    main()
