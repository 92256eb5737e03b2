"""JSBSim itself: the installed library, its log kept silent, an aircraft loaded, its properties by checked names."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from flightstack.types import InputError
from flightstack_sim.jsbsim.aircraft import Aircraft

CHECKED_VERSIONS: Final = ("1.3",)
"""Versions that this plant was held against closed forms with; properties and frames changed between others."""
SECOND_ORDER: Final = 3
EULER: Final = 1
"""JSBSim's numbers of integrators: Adams-Bashforth of second order, and Euler's."""
INTEGRATORS: Final = tuple(
    f"simulation/integrator/{what}/{how}" for what in ("rate", "position") for how in ("rotational", "translational")
)

_GRAVITY_MODEL: Final = "simulation/gravity-model"
_ROUND: Final = 0.0
"""JSBSim's number of the gravity of a ball."""
_READ: Final = re.compile(r"<property>([^<]*)</property>")
_LONGEST: Final = 300
_MOTION: Final = "simulation/models/FGPropagate/enabled"


def library() -> ModuleType:
    """The module `jsbsim`; InputError where it is missing or of a version that this plant doesn't know."""
    try:
        import jsbsim
    except ImportError as error:
        raise InputError(
            f"--plant jsbsim: JSBSim is not installed ({error}): pip install 'jsbsim>=1.3,<1.4' (wheels exist for "
            "x86-64 only), or fly --plant native"
        ) from None
    version = str(getattr(jsbsim, "__version__", "unknown"))
    if ".".join(version.split(".")[:2]) not in CHECKED_VERSIONS:
        raise InputError(
            f"--plant jsbsim: JSBSim {version} is installed, this plant knows {', '.join(CHECKED_VERSIONS)}: "
            "pip install 'jsbsim>=1.3,<1.4', or fly --plant native"
        )
    module: ModuleType = jsbsim
    return module


class Fdm:
    """One loaded aircraft, initialised; `get` and `set` give a property's own functions, once its name is checked."""

    def __init__(self, aircraft: Aircraft, initial: Mapping[str, float], *, dt_s: float, planet: str = "") -> None:
        jsbsim = library()
        heard: list[str] = []
        jsbsim.set_logger(_logger(jsbsim, heard))
        try:
            self._exec = self._load(jsbsim, aircraft, planet)
            self._properties = self._exec.get_property_manager()
            self._check_functions(aircraft)
            self.write(initial)
            if planet:
                self.write({_GRAVITY_MODEL: _ROUND})
            self._exec.set_dt(dt_s)
            if not self._exec.run_ic():
                raise RuntimeError("the initial state was refused")
            self.write({f"simulation/models/FG{name}/enabled": 0.0 for name in aircraft.idle})
            self.write(aircraft.first)
            if not self.get("inertia/mass-slugs")() > 0.0:
                raise RuntimeError("it has no mass")
        except InputError:
            raise
        except Exception as error:  # the library raises several kinds, some of them its own
            why = " ".join(f"{error}: {' '.join(heard[-2:])}".split())
            raise InputError(
                f"--plant jsbsim: JSBSim {jsbsim.__version__} cannot fly {aircraft.name}: {why[:_LONGEST]}"
            ) from None

    def settle(self, aircraft: Aircraft, states: Mapping[str, float], commands: Sequence[float]) -> None:
        """Let forces, delays and motors take on what was carried over, the body standing still: before the first step.

        `commands`: what the motors are told meanwhile, for as long as they need.
        """
        held = {**dict(zip(aircraft.commands, commands, strict=True)), **states}
        self.write({_MOTION: 0.0})
        for _ in range(aircraft.settle_frames):
            self.write(held)
            self._exec.run()
        self.write({**states, _MOTION: 1.0})
        self.write(dict.fromkeys(INTEGRATORS, EULER))  # JSBSim has no accelerations of the past to extrapolate

    def first_run(self, then: Callable[[Callable[[], bool]], None]) -> Callable[[], bool]:
        """Runs the first frame; hands what runs all later ones to `then`."""

        def run() -> bool:
            done = bool(self._exec.run())
            self.write(dict.fromkeys(INTEGRATORS, SECOND_ORDER))
            then(self._exec.run)
            return done

        return run

    @staticmethod
    def _load(jsbsim: ModuleType, aircraft: Aircraft, planet: str) -> Any:
        """JSBSim reads aircraft from files only: a folder that is gone once it is loaded."""
        fdm = jsbsim.FGFDMExec(None)
        fdm.set_debug_level(0)
        with tempfile.TemporaryDirectory(prefix="flightstack-jsbsim-") as folder:
            home = Path(folder) / aircraft.name
            home.mkdir()
            for name, content in aircraft.files.items():
                (home / name).write_text(content, encoding="utf-8")
            if planet:
                path = Path(folder) / "planet.xml"
                path.write_text(planet, encoding="utf-8")
                fdm.load_planet(str(path), False)
            fdm.set_aircraft_path(folder)
            if not fdm.load_model(aircraft.name):
                raise RuntimeError("the aircraft was refused")
        return fdm

    def _check_functions(self, aircraft: Aircraft) -> None:
        """Every property that the aircraft's functions read exists; JSBSim would abort the whole process over one."""
        read = {name.strip() for content in aircraft.files.values() for name in _READ.findall(content)}
        missing = sorted(name for name in read if not self._properties.hasNode(name))
        for name in missing:
            self._exec.set_property_value(name, 0.0)  # it reads them once more when it is thrown away
        self.check_known(missing)

    @staticmethod
    def check_known(missing: Sequence[str]) -> None:
        """InputError that names what JSBSim doesn't know."""
        if missing:
            raise InputError(
                f"--plant jsbsim: JSBSim has no property {', '.join(missing)}: its version is not the one expected, "
                "or the name is misspelled"
            )

    def check(self, names: Iterable[str]) -> None:
        """InputError where a property doesn't exist: JSBSim itself would silently make a new one."""
        self.check_known([name for name in names if not self._properties.hasNode(name)])

    def get(self, name: str) -> Callable[[], float]:
        """Reads a property."""
        self.check((name,))
        read: Callable[[], float] = self._properties.get_node(name).get_double_value
        return read

    def set(self, name: str) -> Callable[[float], bool]:
        """Writes a property."""
        self.check((name,))
        write: Callable[[float], bool] = self._properties.get_node(name).set_double_value
        return write

    def read(self, names: Iterable[str]) -> dict[str, float]:
        """Properties and their values."""
        return {name: self.get(name)() for name in names}

    def write(self, values: Mapping[str, float]) -> None:
        """Give properties their values."""
        for name, value in values.items():
            self.set(name)(value)


def _logger(jsbsim: ModuleType, heard: list[str]) -> Any:
    """A logger that says nothing and keeps warnings and errors: the debug level alone does not silence JSBSim."""

    class Silent(jsbsim.FGLogger):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.kept = False

        def set_level(self, level: int) -> None:
            self.kept = jsbsim.LogLevel.WARN <= level <= jsbsim.LogLevel.FATAL

        def file_location(self, filename: str, line: int) -> None:
            pass

        def message(self, message: str) -> None:
            if self.kept:
                heard.append(message)
                del heard[:-20]

        def format(self, format: int) -> None:
            pass

        def flush(self) -> None:
            pass

    return Silent()
