"""What users import, in one place: `from flightstack.api import read_log, RecursiveGP, EFFECTS, NativePlant`.

Each name is fetched when it is first asked for: importing this module loads nothing else, and `analyse` brings no
simulator along.  These names are stable; where they live is not.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flightstack.barrier.file import parse_certificate
    from flightstack.barrier.records import Certificate
    from flightstack.certificate_check import check as check_certificate
    from flightstack.cli.files import load_scenario, load_vehicle
    from flightstack.cli.flight import FlyOptions, fly
    from flightstack.errors import InputError
    from flightstack.flatness import to_body, to_flat
    from flightstack.gap.result import GapResult
    from flightstack.gap.workflow import analyse
    from flightstack.gp import RecursiveGP, SquaredExponential
    from flightstack.model import Limits, Model
    from flightstack.safety_filter import BarrierFilter
    from flightstack.scenario import Scenario, parse_scenario
    from flightstack.vehicle import Vehicle, parse_vehicle, vehicle_to_toml
    from flightstack_logs.convert import convert as convert_log
    from flightstack_logs.export import export as export_log
    from flightstack_logs.reader import read as read_log
    from flightstack_logs.recover import recover as recover_log
    from flightstack_logs.standard import with_vehicle_topics
    from flightstack_logs.tables import Log, Table
    from flightstack_sim.batch import BatchClosedLoop, BatchPlant
    from flightstack_sim.effects import EFFECTS
    from flightstack_sim.jsbsim.plant import JsbsimPlant
    from flightstack_sim.plant import NativePlant, Plant, Truth

_HOME = {
    "EFFECTS": "flightstack_sim.effects",
    "BarrierFilter": "flightstack.safety_filter",
    "BatchClosedLoop": "flightstack_sim.batch",
    "BatchPlant": "flightstack_sim.batch",
    "Certificate": "flightstack.barrier.records",
    "FlyOptions": "flightstack.cli.flight",
    "GapResult": "flightstack.gap.result",
    "InputError": "flightstack.errors",
    "JsbsimPlant": "flightstack_sim.jsbsim.plant",
    "Limits": "flightstack.model",
    "Log": "flightstack_logs.tables",
    "Model": "flightstack.model",
    "NativePlant": "flightstack_sim.plant",
    "Plant": "flightstack_sim.plant",
    "RecursiveGP": "flightstack.gp",
    "Scenario": "flightstack.scenario",
    "SquaredExponential": "flightstack.gp",
    "Table": "flightstack_logs.tables",
    "Truth": "flightstack_sim.plant",
    "Vehicle": "flightstack.vehicle",
    "analyse": "flightstack.gap.workflow",
    "check_certificate": "flightstack.certificate_check:check",
    "convert_log": "flightstack_logs.convert:convert",
    "export_log": "flightstack_logs.export:export",
    "fly": "flightstack.cli.flight",
    "load_scenario": "flightstack.cli.files",
    "load_vehicle": "flightstack.cli.files",
    "parse_certificate": "flightstack.barrier.file",
    "parse_scenario": "flightstack.scenario",
    "parse_vehicle": "flightstack.vehicle",
    "read_log": "flightstack_logs.reader:read",
    "recover_log": "flightstack_logs.recover:recover",
    "to_body": "flightstack.flatness",
    "to_flat": "flightstack.flatness",
    "vehicle_to_toml": "flightstack.vehicle",
    "with_vehicle_topics": "flightstack_logs.standard",
}
"""Name -> module, with `:NAME` where it is called otherwise there."""

__all__ = [
    "EFFECTS",
    "BarrierFilter",
    "BatchClosedLoop",
    "BatchPlant",
    "Certificate",
    "FlyOptions",
    "GapResult",
    "InputError",
    "JsbsimPlant",
    "Limits",
    "Log",
    "Model",
    "NativePlant",
    "Plant",
    "RecursiveGP",
    "Scenario",
    "SquaredExponential",
    "Table",
    "Truth",
    "Vehicle",
    "analyse",
    "check_certificate",
    "convert_log",
    "export_log",
    "fly",
    "load_scenario",
    "load_vehicle",
    "parse_certificate",
    "parse_scenario",
    "parse_vehicle",
    "read_log",
    "recover_log",
    "to_body",
    "to_flat",
    "vehicle_to_toml",
    "with_vehicle_topics",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, own = home.partition(":")
    found = getattr(import_module(module), own or name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
