"""`flightstack.api`: every name is what it says, none is fetched before it is asked for, the lists agree."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from flightstack import api

SOURCE = ast.parse(Path(api.__file__).read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", api.__all__)
def test_every_name_is_the_thing_itself_with_a_docstring(name: str) -> None:
    module, _, own = api._HOME[name].partition(":")
    if name == "JsbsimPlant":
        pytest.importorskip("jsbsim")
    found = getattr(api, name)
    assert found is getattr(import_module(module), own or name)
    assert name == "EFFECTS" or found.__doc__


def test_the_list_for_type_checkers_is_the_list_that_is_fetched_from() -> None:
    told = {}
    for node in ast.walk(SOURCE):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("flightstack"):
            for alias in node.names:
                own = f":{alias.name}" if alias.asname and alias.asname != alias.name else ""
                told[alias.asname or alias.name] = f"{node.module}{own}"
    assert told == api._HOME
    assert sorted(api.__all__) == sorted(api._HOME)
    assert set(api.__all__) <= set(dir(api))


def test_importing_it_loads_nothing_and_a_name_only_what_it_needs() -> None:
    code = (
        "import json, sys\n"
        "import flightstack.api as api\n"
        "heavy = ('numpy', 'flightstack_sim', 'flightstack_logs')\n"
        "first = sorted(m for m in sys.modules if m.split('.')[0] in heavy)\n"
        "api.RecursiveGP\n"
        "print(json.dumps([first, any(m.startswith('flightstack_sim') for m in sys.modules)]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [[], False]


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        api.nothing_of_the_kind  # noqa: B018


def test_it_is_enough_to_fly_a_plant_and_to_learn() -> None:
    """A hundred milliseconds of free fall from rest on the ground stay on the ground; a process learns a point."""
    vehicle, _ = api.load_vehicle("quad-x")
    plant = api.NativePlant(vehicle, seed=1)
    assert plant.truth().on_ground
    assert "payload" in api.EFFECTS
    kernel = api.SquaredExponential(1.0, [1.0])
    process = api.RecursiveGP(kernel, 1e-6, input_dim=1, output_dim=1, capacity=4)
    process.add(np.array([0.0]), np.array([2.0]))
    mean, variance = process.predict(np.array([[0.0]]))
    assert float(np.asarray(mean).reshape(-1)[0]) == pytest.approx(2.0, abs=1e-4)
    assert float(np.asarray(variance).reshape(-1)[0]) < 1e-4
